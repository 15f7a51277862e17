//! What a reader of scenes is, and the checks that all of them share: of all photos of a scene
//! together. Knows no format, and decodes no photo.

use std::path::{Path, PathBuf};

use formats::Camera;

use crate::parsed::{ParsedScene, Posed};
use crate::plausible::{self, Stray};
use crate::{SceneData, SceneError};

/// A reader of posed photos of one format.
///
/// A new format says in [`Reader::parse`] what a scene is made of; reading, the digest and all
/// checks that do not depend on a format follow from that.
///
/// ```no_run
/// use scene::{Colmap, Reader};
///
/// let scene = Colmap { folder: "south-building".into(), images: None, size: Some((768, 512)) }.read()?;
/// println!("{} photos; {}", scene.photos.len(), scene.notes.join("; "));
/// # Ok::<(), scene::SceneError>(())
/// ```
pub trait Reader {
    /// What the scene is made of: files, cameras, and what is noteworthy about them. No photo is
    /// decoded.
    ///
    /// # Errors
    /// Every way in which the files can be unfit, by file and place, but for photos that cannot be
    /// decoded.
    fn parse(&self) -> Result<ParsedScene, SceneError>;

    /// The scene: photos resized to the size asked for by an antialiased bicubic filter, intrinsics
    /// to match.
    ///
    /// # Errors
    /// Those of [`Reader::parse`], and photos that are damaged.
    fn read(&self) -> Result<SceneData, SceneError> {
        self.parse()?.read()
    }

    /// The files that [`Reader::read`] reads.
    ///
    /// # Errors
    /// Those of [`Reader::parse`].
    fn files(&self) -> Result<Vec<PathBuf>, SceneError> {
        let parsed = self.parse()?;
        Ok(parsed.files().map(Path::to_owned).collect())
    }

    /// A BLAKE3 digest over the names and bytes of these files: whether the scene on disk has
    /// changed.
    ///
    /// # Errors
    /// Those of [`Reader::parse`].
    fn digest(&self) -> Result<[u8; 32], SceneError> {
        self.parse()?.digest()
    }
}

/// Looks at all photos of a scene together: leaves out those whose camera stands far from all
/// others, and notes or refuses what makes no scene. `path` is the file that the poses stand in.
pub(crate) fn sift(
    path: &Path,
    train: &mut Vec<Posed>,
    test: &mut Vec<Posed>,
    size: Option<(u32, u32)>,
) -> Result<Vec<String>, SceneError> {
    if train.is_empty() {
        return Err(SceneError::content(
            path,
            "the photos",
            "are none that can be used",
        ));
    }
    // Names become files: two photos of one name would overwrite one another.
    refuse_twice(path, train)?;
    refuse_twice(path, test)?;
    // Before the other checks, which one stray would spoil.
    let mut notes = leave_out_strays(train, test);
    let posed = || train.iter().chain(test.iter());
    let cameras: Vec<Camera> = posed().map(|posed| posed.camera).collect();
    if plausible::at_one_place(&cameras) {
        let fault = "stand at one place, from which no depth can be seen: the pose estimation failed, or its \
                     translations were lost";
        let place = format!("all {} cameras", cameras.len());
        return Err(SceneError::content(path, place, fault));
    }
    let is_outside = |camera: &Camera| {
        !(0.0..=f64::from(camera.width)).contains(&camera.cx)
            || !(0.0..=f64::from(camera.height)).contains(&camera.cy)
    };
    if let Some(odd) = posed().find(|posed| is_outside(&posed.camera)) {
        notes.push(format!(
            "the principal point ({}, {}) of photo {} lies outside its {}x{} pixels: right for a cropped photo, wrong if \
             it was found at another size",
            odd.camera.cx, odd.camera.cy, odd.name, odd.camera.width, odd.camera.height
        ));
    }
    notes.extend(size.and_then(|size| enlarged(posed(), size)));
    Ok(notes)
}

fn refuse_twice(path: &Path, photos: &[Posed]) -> Result<(), SceneError> {
    let mut by_file: Vec<&Posed> = photos.iter().collect();
    by_file.sort_by(|a, b| a.file.cmp(&b.file));
    let mut by_name = by_file.clone();
    by_name.sort_by(|a, b| a.name.cmp(&b.name));
    let twice = by_file
        .windows(2)
        .find(|pair| pair[0].file == pair[1].file)
        .or_else(|| by_name.windows(2).find(|pair| pair[0].name == pair[1].name));
    match twice {
        None => Ok(()),
        Some(pair) => Err(SceneError::content(
            path,
            format!("the photo {}", pair[1].file.display()),
            format!(
                "has two poses, or its name {} is another's too: leave it one",
                pair[1].name
            ),
        )),
    }
}

fn leave_out_strays(train: &mut Vec<Posed>, test: &mut Vec<Posed>) -> Vec<String> {
    let cameras: Vec<Camera> = train
        .iter()
        .chain(test.iter())
        .map(|posed| posed.camera)
        .collect();
    // Test cameras as well: one that is far off would be measured at a place nobody saw.
    let (strays, few) = plausible::strays(&cameras);
    let name = |index: usize| match index.checked_sub(train.len()) {
        None => &train[index].name,
        Some(index) => &test[index].name,
    };
    let note = |stray: &Stray| {
        let Stray { index, times } = *stray;
        let name = name(index);
        let end = match few {
            true => "left out, its pose must be wrong",
            false => {
                "such cameras are too many to be left out, and make the scene box far too large"
            }
        };
        format!(
            "the camera of photo {name} stands {times:.0} times as far away as nine tenths of them: {end}"
        )
    };
    let notes = strays.iter().map(note).collect();
    if few {
        // From the last one on, so that the others keep their places.
        for Stray { index, .. } in strays.iter().rev() {
            match index.checked_sub(train.len()) {
                None => train.remove(*index),
                Some(index) => test.remove(index),
            };
        }
    }
    notes
}

fn enlarged<'p>(photos: impl Iterator<Item = &'p Posed>, size: (u32, u32)) -> Option<String> {
    let smaller: Vec<&Posed> = photos
        .filter(|posed| posed.camera.width < size.0 || posed.camera.height < size.1)
        .collect();
    let first = smaller.first()?;
    Some(format!(
        "{} photos are smaller than the {}x{} asked for and are enlarged, such as {} of {}x{}: they have no more detail \
         for it",
        smaller.len(),
        size.0,
        size.1,
        first.name,
        first.camera.width,
        first.camera.height
    ))
}
