//! `Scene`: reads or draws posed photos, reduces them and holds some out. Knows nothing of fields.

pub mod origin;
mod outputs;

use std::path::PathBuf;

use artifacts_schema::{Digest, image_stream};
use scene::{ParsedScene, Photo, Reducer, SceneError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::origin::{Origin, WORLDS};
use self::outputs::{Ready, Sets, Split, TEST, TEST_LOW, TRAIN};
use crate::convert;
use crate::error::StageError;
use crate::files;
use crate::io::Io;
use crate::port::{InputPort, OutputPort, Port};
use crate::size::{Foretold, Size, Sizes};
use crate::stage::{Estimate, Source, Stage, WRITTEN_SECONDS};

/// Bytes of a drawn pixel: colours and coverage, once more for the rows of a photo.
const DRAWN: u64 = 24;
/// Seconds of two cores for a drawn ray, and for a pixel that is decoded and reduced.
const RAY: f64 = 1e-7;
const DECODED: f64 = 2e-8;

/// Posed photos: low-resolution ones to train on, and held-out ones at both resolutions.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Scene {
    /// Where the photos come from.
    pub source: Origin,
    /// Size of the full-resolution photos over the size of the low-resolution ones.
    #[schemars(range(min = 1, max = 64))]
    pub downscale: u32,
    /// The filter that makes the low-resolution photos.
    pub filter: Reducer,
    /// Every so many photos, in the order of their names, one is held out: numbers 0, 8, 16 …
    /// for 8. A source that sets photos aside by itself has the last word.
    #[schemars(range(min = 2, max = 1_000_000))]
    pub holdout: u32,
}

/// The photos of a source that are not decoded yet.
#[derive(Default)]
struct Photos {
    /// Widths and heights, and those of the files that are decoded.
    sizes: Vec<(u32, u32)>,
    files: Vec<(u32, u32)>,
    /// How many are to train on or to split, and how many the source sets aside.
    counts: (usize, usize),
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            source: Origin::default(),
            downscale: 4,
            filter: Reducer::Bicubic,
            holdout: 8,
        }
    }
}

impl Scene {
    /// Reads the photos of a source, and writes each as it is decoded.
    fn read(&self, parsed: ParsedScene, io: &Io) -> Result<(), StageError> {
        let split = self.split(parsed.counts())?;
        let mut sets = Sets::new(io, parsed.bounds(), parsed.to_source());
        let notes = parsed.for_each(
            |at, photo| self.ready(&photo, split.holds_out(at)),
            |ready| {
                sets.add(ready)?;
                io.progress(sets.done, split.photos, &[])
            },
        )?;
        notes.iter().for_each(|note| io.remark(note));
        sets.finish()
    }

    /// Draws a world by the seed, and writes its photos. All are in memory, since box, near and far
    /// follow from all of them.
    fn draw(&self, io: &Io) -> Result<(), StageError> {
        let Origin::Procedural {
            world,
            views,
            size,
            samples,
        } = &self.source
        else {
            return Err(StageError::Mismatch("the source has no reader".into()));
        };
        let draw = match world.as_str() {
            "object" => scene::object,
            _ => scene::still_life,
        };
        let data = draw(*views, *size, *samples, io.seed);
        let split = self.split((data.photos.len(), data.test.len()))?;
        let mut sets = Sets::new(io, data.bounds, data.to_source);
        for (at, photo) in data.photos.iter().chain(&data.test).enumerate() {
            sets.add(self.ready(photo, split.holds_out(at))?)?;
            io.progress(sets.done, split.photos, &[])?;
        }
        sets.finish()
    }

    /// The photos that there will be. `None` if the source cannot be read: running the stage says why.
    fn photos(&self) -> Option<Photos> {
        if let Origin::Procedural {
            world, views, size, ..
        } = &self.source
        {
            let aside = match world.as_str() {
                "object" => scene::object_tests(*views),
                _ => 0,
            };
            return Some(Photos {
                sizes: vec![*size; (views + aside) as usize],
                files: Vec::new(),
                counts: (*views as usize, aside as usize),
            });
        }
        let parsed = self.source.reader()?.parse().ok()?;
        Some(Photos {
            sizes: parsed.sizes().collect(),
            files: parsed.file_sizes().collect(),
            counts: parsed.counts(),
        })
    }

    /// Which photos are held out. There are `train` to train on or to split, and `test` that the
    /// source sets aside. Refuses a source that leaves nothing to train on or nothing to hold out.
    fn split(&self, (train, test): (usize, usize)) -> Result<Split, StageError> {
        let split = Split {
            photos: train + test,
            aside: (test > 0).then_some(train),
            every: self.holdout as usize,
        };
        let held_out = (0..split.photos).filter(|&at| split.holds_out(at)).count();
        match held_out == 0 || held_out == split.photos {
            true => Err(StageError::Mismatch(format!(
                "the scene has {train} photos, too few to hold any out and train on the others"
            ))),
            false => Ok(split),
        }
    }

    /// A photo in the forms in which it is written.
    fn ready(&self, photo: &Photo, held_out: bool) -> Result<Ready, SceneError> {
        Ok(Ready {
            low: convert::photo_view(&scene::downscale(photo, self.downscale, self.filter)?),
            full: held_out.then(|| convert::photo_view(photo)),
        })
    }
}

impl Stage for Scene {
    fn kind(&self) -> &'static str {
        "Scene"
    }

    fn version(&self) -> u32 {
        3
    }

    fn check(&self) -> Result<(), StageError> {
        convert::in_range("downscale", self.downscale, 1, 64)?;
        convert::in_range("holdout", self.holdout, 2, 1_000_000)?;
        let size = match &self.source {
            Origin::Procedural {
                world,
                views,
                samples,
                size,
            } => {
                if !WORLDS.contains(&world.as_str()) {
                    let problem = format!("is `{world}`; the worlds are: {}", WORLDS.join(", "));
                    return Err(StageError::parameter("source.world", problem));
                }
                convert::in_range("source.views", *views, 2, 10_000)?;
                convert::in_range("source.samples", *samples, 1, 64)?;
                Some(*size)
            }
            Origin::Transforms {
                test_every, size, ..
            } => {
                convert::in_range("source.test_every", *test_every, 1, 1_000_000)?;
                *size
            }
            Origin::Llff { size, .. } | Origin::Colmap { size, .. } => *size,
        };
        let Some((w, h)) = size else { return Ok(()) };
        // At least eight low-resolution pixels a side.
        convert::in_range("source.size", w.min(h), self.downscale * 8, 16384)?;
        convert::in_range("source.size", w.max(h), self.downscale * 8, 16384)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        Vec::new()
    }

    fn outputs(&self) -> Vec<OutputPort> {
        [TRAIN, TEST, TEST_LOW].map(Port::output).to_vec()
    }

    fn sources(&self) -> Result<Vec<Source>, StageError> {
        let Some(reader) = self.source.reader() else {
            return Ok(Vec::new());
        };
        let parsed = reader.parse()?;
        self.split(parsed.counts())?;
        let digest = parsed.digest()?;
        Ok(vec![Source {
            name: "photos and poses".into(),
            digest: Digest::new(digest),
        }])
    }

    fn source_files(&self) -> Option<Vec<PathBuf>> {
        match &self.source {
            Origin::Procedural { .. } => Some(Vec::new()),
            // Which photos a `transforms.json` names, and where they lie, only reading it tells.
            Origin::Transforms { .. } => None,
            // Another folder of photos may lie beside that of the poses.
            Origin::Llff { path, images, .. } | Origin::Colmap { path, images, .. } => {
                let photos = images
                    .as_ref()
                    .map_or(Some(Vec::new()), |images| files::tree(&path.join(images)))?;
                Some([files::tree(path)?, photos].concat())
            }
        }
    }

    fn locations(&self) -> &'static [&'static str] {
        &["source.path", "source.images"]
    }

    fn foretell(&self, _: &Sizes) -> Foretold {
        let photos = self.photos().unwrap_or_default();
        let Ok(split) = self.split(photos.counts) else {
            return Foretold::new();
        };
        let of = |held_out: bool, factor: u32| {
            let photos = photos.sizes.iter().enumerate();
            let chosen = photos.filter(|(at, _)| split.holds_out(*at) == held_out);
            Size::of_images(
                chosen.map(|(_, (width, height))| (width / factor, height / factor)),
                None,
            )
        };
        [
            (TRAIN, false, self.downscale),
            (TEST, true, 1),
            (TEST_LOW, true, self.downscale),
        ]
        .map(|(port, held_out, factor)| (port.name, of(held_out, factor)))
        .into()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let photos = self.photos().unwrap_or_default();
        let made = Size::of_images(photos.sizes, None);
        if let Origin::Procedural { samples, .. } = &self.source {
            let rays = made.pixels as f64 * f64::from(*samples).powi(2);
            return Estimate::of(DRAWN * made.pixels, rays * RAY);
        }
        let files = Size::of_images(photos.files, None);
        // A photo may be resized to more than its file has.
        let decoding = scene::decoding_memory(files.largest.max(made.largest));
        // Three sets are written at the same time.
        let writing = 2 * made.waiting().min(3 * image_stream::HELD);
        let written: u64 = self.foretell(inputs).values().map(|set| set.pixels).sum();
        let seconds = files.pixels as f64 * DECODED + written as f64 * WRITTEN_SECONDS;
        Estimate::of(decoding + writing, seconds)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        match self.source.reader() {
            Some(reader) => self.read(reader.parse()?, io),
            None => self.draw(io),
        }
    }
}
