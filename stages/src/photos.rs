//! Photos on disk as views to train on. A fixed amount of pixels is kept in memory, and the rest in a
//! file beside the stage's checkpoint. Knows nothing of how training goes.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use artifacts_schema::{StoredImages, View};
use nerf::{PixelFile, TrainPixels, TrainView};

use crate::convert;
use crate::error::StageError;
use crate::size::{Size, Sizes};

/// Bytes of pixels that are kept in memory. The operating system caches as much of the file as there
/// is room for.
const IN_MEMORY: u64 = 2 << 30;
/// Bytes of a pixel to train on: three colours and alpha.
const PIXEL: u64 = 16;
/// A byte holds the masks of so many pixels: a bit each, and half of that for counts.
const MASKED: u64 = 5;
/// Seconds of two cores for a pixel that is read and made ready.
const READ: f64 = 1e-7;
/// The file for what is not in memory, in the stage's scratch folder.
const FILE: &str = "photos";

/// Photos on disk to train on.
pub struct Photos {
    /// The photos.
    pub images: StoredImages,
    /// Factor on the squared error of each of their pixels.
    pub weight: f32,
    /// Sub-rays per pixel and axis.
    pub supersample: u32,
}

impl Photos {
    /// Each photo is made ready as it is read: in both forms at once they would take twice the memory.
    fn read(&self) -> impl Iterator<Item = Result<TrainView, StageError>> {
        let ready = |view: View| convert::train_view(view, self.weight, self.supersample);
        self.images.map(ready).map(|view| Ok(view?))
    }
}

/// Bytes of memory that photos of these sizes take at most.
pub fn memory(inputs: &Sizes) -> u64 {
    let pixels: u64 = inputs.values().map(|size| size.pixels).sum();
    let held: u64 = inputs.values().map(Size::held).sum();
    (PIXEL * pixels).min(IN_MEMORY) + pixels / MASKED + held
}

/// Seconds until photos of these sizes are ready.
pub fn seconds(inputs: &Sizes) -> f64 {
    let pixels: u64 = inputs.values().map(|size| size.pixels).sum();
    pixels as f64 * READ
}

/// The views of all photos in order; an error if masks leave nothing of them. Some of them may lie in
/// a file in `scratch`, which is written anew.
pub fn views(photos: &[Photos], scratch: &Path) -> Result<(Vec<TrainView>, Overflow), StageError> {
    views_within(photos, scratch, IN_MEMORY)
}

fn views_within(
    photos: &[Photos],
    scratch: &Path,
    in_memory: u64,
) -> Result<(Vec<TrainView>, Overflow), StageError> {
    let mut room = in_memory;
    let mut overflow = Overflow::new(scratch);
    let mut views = Vec::new();
    for view in photos.iter().flat_map(Photos::read) {
        let mut view = view?;
        let bytes = PIXEL * u64::from(view.camera.width) * u64::from(view.camera.height);
        match room.checked_sub(bytes) {
            Some(rest) => room = rest,
            None => overflow.take(&mut view)?,
        }
        views.push(view);
    }
    // The sampler would have no pixel to draw.
    if views.iter().all(|view| view.open() == 0) {
        return Err(StageError::Mismatch(
            "masks leave no pixel of any photo to train on: are they black where they should be white?".into(),
        ));
    }
    Ok((views, overflow))
}

/// The file with the pixels that are not in memory.
pub struct Overflow {
    path: PathBuf,
    /// There is none before it is needed.
    file: Option<Arc<PixelFile>>,
}

impl Overflow {
    fn new(scratch: &Path) -> Self {
        Self {
            path: scratch.join(FILE),
            file: None,
        }
    }

    /// Moves the pixels of a view into the file.
    fn take(&mut self, view: &mut TrainView) -> Result<(), StageError> {
        if let TrainPixels::Kept(pixels) = &view.pixels {
            let stored = self.open().and_then(|file| file.add(pixels));
            view.pixels = TrainPixels::Stored(stored.map_err(|error| self.failed(&error))?);
        }
        Ok(())
    }

    fn open(&mut self) -> io::Result<Arc<PixelFile>> {
        if let Some(file) = &self.file {
            return Ok(file.clone());
        }
        self.path.parent().map_or(Ok(()), fs::create_dir_all)?;
        let file = Arc::new(PixelFile::create(&self.path)?);
        self.file = Some(file.clone());
        Ok(file)
    }

    /// An error if a pixel could not be read since the views were made.
    pub fn check(&self) -> Result<(), StageError> {
        let fault = self.file.as_ref().and_then(|file| file.fault());
        fault.map_or(Ok(()), |error| Err(self.failed(error)))
    }

    fn failed(&self, error: &io::Error) -> StageError {
        StageError::File {
            path: self.path.clone(),
            problem: format!("{error} (photos that do not fit into memory are kept there)"),
        }
    }
}

impl Drop for Overflow {
    /// It may be as large as all photos, and is of no use to anybody else.
    fn drop(&mut self) {
        if self.file.take().is_some() {
            // What cannot be removed goes with the scratch folder.
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use artifacts_schema::{Artifact, ImageSet, Provenance};
    use formats::{Camera, Pixels};
    use glam::{DMat4, DVec3};
    use nerf::{Field, FieldConfig, TrainOptions, Trainer};

    use super::*;

    /// Two photos of 8 x 6 pixels, of which one is transparent and masked.
    fn photos(folder: &Path) -> Photos {
        let view = |name: &str, x: f64, alpha, mask| View {
            name: name.into(),
            camera: Camera::centered(
                (8, 6),
                8.0,
                DMat4::from_translation(DVec3::X * x),
                [1.0, 3.0],
            ),
            pixels: Pixels::new((0..144).map(|i| (i % 5) as f32 / 8.0).collect(), alpha),
            depth: None,
            mask,
        };
        let half = Some(vec![0.5; 48]);
        let masked = Some((0..48).map(|i| i % 3 > 0).collect());
        let set = ImageSet {
            views: vec![view("a", 0.0, None, None), view("b", 0.1, half, masked)],
            bounds: [[-1.0, -1.0, -3.0], [1.0, 1.0, -1.0]],
            to_source: None,
        };
        let folder = folder.join("images");
        set.write(&folder, &Provenance::default()).unwrap();
        Photos {
            images: StoredImages::open(&folder).unwrap(),
            weight: 1.0,
            supersample: 1,
        }
    }

    fn trained(views: Vec<TrainView>) -> Field {
        let config = FieldConfig {
            levels: 4,
            log2_table: 10,
            march_steps: 32,
            ..FieldConfig::default()
        };
        let field = Field::new(&config, [[-1.0, -1.0, -3.0], [1.0, 1.0, -1.0]], 1);
        let options = TrainOptions {
            samples: 512,
            ..TrainOptions::default()
        };
        let mut trainer = Trainer::new(field, views, &options, 1);
        for _ in 0..20 {
            trainer.step();
        }
        trainer.into_field()
    }

    #[test]
    fn training_is_the_same_wherever_photos_lie() {
        let folder = tempfile::tempdir().unwrap();
        let scratch = folder.path().join("scratch");
        let photos = [photos(folder.path())];
        let file = scratch.join(FILE);
        let [kept, some, none] = [u64::MAX, 16 * 48, 0].map(|room| {
            let (views, overflow) = views_within(&photos, &scratch, room).unwrap();
            let bytes = fs::metadata(&file).map_or(0, |file| file.len());
            let field = trained(views);
            overflow.check().unwrap();
            (bytes, field.tensors())
        });
        assert_eq!([kept.0, some.0, none.0], [0, 16 * 48, 12 * 48 + 16 * 48]);
        assert!(kept.1 == some.1 && kept.1 == none.1);
        assert!(!file.exists(), "it is removed when training ends");
    }

    #[test]
    fn a_file_that_breaks_off_ends_training_with_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let scratch = folder.path().join("scratch");
        let (views, overflow) = views_within(&[photos(folder.path())], &scratch, 0).unwrap();
        let file = fs::File::options().write(true).open(scratch.join(FILE));
        file.unwrap().set_len(0).unwrap();
        overflow.check().unwrap();
        trained(views);
        let error = overflow.check().unwrap_err().to_string();
        assert!(
            error.starts_with(&scratch.join(FILE).display().to_string()),
            "{error}"
        );
    }

    #[test]
    fn many_photos_take_no_more_memory_than_is_set_aside() {
        let sized = |photos: usize| {
            let size = Size::of_images(vec![(4032, 3024); photos], None);
            memory(&[("images", size)].into())
        };
        assert!(sized(3) < 2 << 30);
        assert!(sized(300) < 4 << 30);
    }
}
