//! Reads scenes whose cameras stand in `transforms.json`: NeRF-synthetic (Mildenhall et al. 2020), instant-ngp,
//! nerfstudio, and our own image sets. Knows nothing of what is done with them.
//!
//! All of them write camera-to-world matrices with OpenGL axes, ours, and coordinates are kept as they are. A file that
//! says nothing of a scene box has instant-ngp's: p * `scale` + `offset` fills the cube of side `aabb_scale` about
//! (0.5, 0.5, 0.5); with the usual 0.33, 0.5 and 1 that is ±1.515, where the objects of NeRF-synthetic are.

mod file;
mod write;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::source_files::{self, Posed};
use crate::{Camera, Photo, SceneData, SceneError, image_file, pose};
use file::{File, Frame};

pub use write::write_transforms;

/// instant-ngp's defaults.
const SCALE: f64 = 0.33;
const OFFSET: [f64; 3] = [0.5; 3];

/// How to read a scene from `transforms.json`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransformsOptions {
    /// Width and height of all photos; by default those of the files.
    pub size: Option<(u32, u32)>,
    /// The scene box, in the file's own coordinates; by default what the file says.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Only every so many of the photos that the scene sets aside for testing; 0 and 1 take all.
    pub test_every: u32,
}

/// Photos of one file, not decoded yet.
#[derive(Default)]
struct Survey {
    sources: Vec<PathBuf>,
    train: Vec<Posed>,
    test: Vec<Posed>,
    bounds: Option<[[f64; 3]; 2]>,
    notes: Vec<String>,
}

/// Reads the scene at `path`: a JSON file, or a folder with `transforms.json`, or one with `transforms_train.json` and
/// `transforms_test.json` (or, where that is missing, `transforms_val.json`).
///
/// Photos are those that the frames name, with or without extension; frames without a photo are left out, and noted.
/// What the source sets aside for testing, by file or by nerfstudio's `test_filenames`, is in [`SceneData::test`].
///
/// # Errors
/// Every way in which the files can be unfit, as a [`SceneError`] that names file and field.
pub fn transforms(path: &Path, options: &TransformsOptions) -> Result<SceneData, SceneError> {
    let survey = survey(path, options)?;
    let (train, test) = (&survey.train, &survey.test);
    let photos = source_files::read_photos(train, options.size)?;
    let name = path
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default();
    Ok(SceneData {
        description: format!(
            "{name}: {} photos, {} set aside, in the file's coordinates",
            train.len(),
            test.len()
        ),
        test: sorted(source_files::read_photos(test, options.size)?),
        photos: sorted(photos),
        bounds: survey.bounds.unwrap_or_else(|| pose::hull(&cameras(train))),
        notes: survey.notes,
    })
}

/// A digest over the files that [`transforms`] would read with the same arguments: whether the scene on disk has
/// changed.
///
/// # Errors
/// The same as [`transforms`]'s, but for photos that cannot be decoded.
pub fn transforms_digest(path: &Path, options: &TransformsOptions) -> Result<[u8; 32], SceneError> {
    let survey = survey(path, options)?;
    let photos = survey
        .train
        .iter()
        .chain(&survey.test)
        .map(|posed| posed.file.as_path());
    source_files::digest(survey.sources.iter().map(PathBuf::as_path).chain(photos))
}

/// The cameras of a file's frames, in its order, whether their photos are there or not. Where the file gives no size,
/// near or far, those of `like` serve.
pub(crate) fn cameras_of_file(path: &Path, like: &Camera) -> Result<Vec<Camera>, SceneError> {
    let file = File::read(path)?;
    let camera = |frame: &Frame| {
        let (camera, has_range) =
            file.camera(frame, (like.width, like.height))
                .map_err(|fault| {
                    SceneError::content(path, format!("frame {:?}", frame.file_path), fault)
                })?;
        let [near, far] = if has_range {
            [camera.near, camera.far]
        } else {
            [like.near, like.far]
        };
        Ok(Camera {
            near,
            far,
            ..camera
        })
    };
    file.frames.iter().map(camera).collect()
}

fn survey(path: &Path, options: &TransformsOptions) -> Result<Survey, SceneError> {
    source_files::check_size(path, options.size)?;
    check_bounds(path, options.bounds.as_ref())?;
    let [whole, train] = ["transforms.json", "transforms_train.json"].map(|name| path.join(name));
    let mut survey = match (path.is_file(), train.is_file(), whole.is_file()) {
        (true, ..) => survey_file(path, options)?,
        (_, true, _) => survey_splits(path, &train, options)?,
        (_, _, true) => survey_file(&whole, options)?,
        _ => {
            let remedy = "point to a folder with transforms.json or transforms_train.json, or to such a file".into();
            return Err(SceneError::Missing {
                path: whole,
                expected: "the cameras",
                remedy,
            });
        }
    };
    let step = options.test_every.max(1) as usize;
    survey.test = survey.test.into_iter().step_by(step).collect();
    Ok(survey)
}

/// One file for each split, as NeRF-synthetic has it.
fn survey_splits(
    folder: &Path,
    train: &Path,
    options: &TransformsOptions,
) -> Result<Survey, SceneError> {
    let mut survey = survey_file(train, options)?;
    let test = ["transforms_test.json", "transforms_val.json"].map(|name| folder.join(name));
    match test.into_iter().find(|path| path.is_file()) {
        Some(path) => {
            let other = survey_file(&path, options)?;
            survey.test = other.train;
            survey.sources.extend(other.sources);
            survey.notes.extend(other.notes);
        }
        None => survey
            .notes
            .push("there is neither transforms_test.json nor transforms_val.json beside it".into()),
    }
    Ok(survey)
}

fn survey_file(path: &Path, options: &TransformsOptions) -> Result<Survey, SceneError> {
    let file = File::read(path)?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let (mut survey, mut missing) = (
        Survey {
            sources: vec![path.to_owned()],
            ..Survey::default()
        },
        Vec::new(),
    );
    let paths: Vec<&str> = file
        .frames
        .iter()
        .map(|frame| frame.file_path.as_str())
        .collect();
    let (mut photos, mut ranged) = (Vec::new(), true);
    for (frame, name) in file.frames.iter().zip(source_files::view_names(&paths)) {
        let Some(photo) = image_file::find(&folder.join(&frame.file_path)) else {
            missing.push(frame.file_path.as_str());
            continue;
        };
        let (camera, has_range) = camera(path, &file, frame, &photo)?;
        ranged &= has_range;
        photos.push((
            frame,
            Posed {
                name,
                file: photo,
                camera,
            },
        ));
    }
    if let Some(first) = missing.first() {
        if photos.is_empty() {
            let remedy = format!(
                "the frames of {} name photos relative to its folder",
                path.display()
            );
            return Err(SceneError::Missing {
                path: folder.join(first),
                expected: "the photo",
                remedy,
            });
        }
        survey.notes.push(format!(
            "{} of {} photos are missing, such as {first}",
            missing.len(),
            paths.len()
        ));
    }
    let unused = file.unused();
    if !unused.is_empty() {
        survey.notes.push(format!(
            "not used of {}: {}",
            path.display(),
            unused.join(", ")
        ));
    }
    survey.bounds = place(path, &file, &mut photos, ranged, options, &mut survey.notes)?;
    let test: BTreeSet<&str> = file.test_filenames.iter().map(String::as_str).collect();
    let used = used(&file);
    for (frame, posed) in photos.into_iter().filter(|(frame, _)| used(frame)) {
        let split = if test.contains(frame.file_path.as_str()) {
            &mut survey.test
        } else {
            &mut survey.train
        };
        split.push(posed);
    }
    match survey.train.is_empty() {
        true => Err(SceneError::content(
            path,
            "train_filenames",
            "leaves no photo to train on",
        )),
        false => Ok(survey),
    }
}

/// Which frames belong to the training or test split; without splits, all.
fn used(file: &File) -> impl Fn(&Frame) -> bool + use<> {
    let listed: BTreeSet<String> = file
        .train_filenames
        .iter()
        .chain(&file.test_filenames)
        .cloned()
        .collect();
    let (all, validation) = (
        file.train_filenames.is_empty(),
        file.val_filenames.iter().cloned().collect::<BTreeSet<_>>(),
    );
    move |frame| match all {
        true => !validation.contains(&frame.file_path),
        false => listed.contains(&frame.file_path),
    }
}

fn camera(
    path: &Path,
    file: &File,
    frame: &Frame,
    photo: &Path,
) -> Result<(Camera, bool), SceneError> {
    let size = image_file::size(photo)?;
    let (camera, has_range) = file.camera(frame, size).map_err(|fault| {
        SceneError::content(path, format!("frame {:?}", frame.file_path), fault)
    })?;
    Ok((source_files::at_size_of_file(&camera, photo)?, has_range))
}

/// Finds the scene box, and the near and far of all cameras if the file does not say them.
fn place(
    path: &Path,
    file: &File,
    photos: &mut [(&Frame, Posed)],
    ranged: bool,
    options: &TransformsOptions,
    notes: &mut Vec<String>,
) -> Result<Option<[[f64; 3]; 2]>, SceneError> {
    check_bounds(path, file.aabb.as_ref())?;
    let bounds = match options.bounds.or(file.aabb) {
        Some(bounds) => Some(bounds),
        None => cube(path, file)?,
    };
    if ranged {
        return Ok(bounds);
    }
    let cameras: Vec<Camera> = photos
        .iter()
        .map(|(_, posed)| posed.camera.clone())
        .collect();
    let guess = pose::guess_depths(&cameras);
    if bounds.is_none() {
        notes.push(format!(
            "the file gives no scene box (`aabb_scale`): taken from the cameras alone, near {:.3} and far {:.3}; set \
             `bounds` if it does not fit",
            guess[0], guess[1]
        ));
    }
    for (_, posed) in photos {
        let range = bounds
            .as_ref()
            .map_or(guess, |bounds| pose::depths_of_box(&posed.camera, bounds));
        [posed.camera.near, posed.camera.far] = range;
    }
    Ok(bounds)
}

/// instant-ngp's cube in the file's coordinates. Without `aabb_scale` only a NeRF-synthetic file, which has a field of
/// view and no focal length, means it.
fn cube(path: &Path, file: &File) -> Result<Option<[[f64; 3]; 2]>, SceneError> {
    let Some(side) = file
        .aabb_scale
        .or(file.has_field_of_view_alone().then_some(1.0))
    else {
        return Ok(None);
    };
    let (scale, offset) = (file.scale.unwrap_or(SCALE), file.offset.unwrap_or(OFFSET));
    let bounds = [-0.5, 0.5].map(|half| offset.map(|offset| (0.5 + half * side - offset) / scale));
    check_bounds(path, Some(&bounds))?;
    Ok(Some(bounds))
}

fn check_bounds(path: &Path, bounds: Option<&[[f64; 3]; 2]>) -> Result<(), SceneError> {
    let Some([low, high]) = bounds else {
        return Ok(());
    };
    let sound = |axis: usize| low[axis] < high[axis] && (high[axis] - low[axis]).is_finite();
    match (0..3).all(sound) {
        true => Ok(()),
        false => Err(SceneError::content(
            path,
            "the scene box",
            format!("{low:?} is not below {high:?} on all axes"),
        )),
    }
}

fn cameras(posed: &[Posed]) -> Vec<Camera> {
    posed.iter().map(|posed| posed.camera.clone()).collect()
}

fn sorted(mut photos: Vec<Photo>) -> Vec<Photo> {
    photos.sort_by(|a, b| a.name.cmp(&b.name));
    photos
}
