//! Reads scenes whose cameras stand in `transforms.json`: NeRF-synthetic (Mildenhall et al. 2020),
//! instant-ngp, nerfstudio, and our own image sets. Knows nothing of what is done with them.
//!
//! All of them write camera-to-world matrices with OpenGL axes, ours, and coordinates are kept as
//! they are, unless they are so far from the origin that single precision would blur them. A file
//! that says nothing of a scene box has instant-ngp's: p * `scale` + `offset` fills the cube of
//! side `aabb_scale` about (0.5, 0.5, 0.5); with the usual 0.33, 0.5 and 1 that is ±1.515, where
//! the objects of NeRF-synthetic are.

mod lens;
mod page;
mod place;
mod splits;
mod write;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::faults::Faults;
use crate::finder;
use crate::gathering::{Gathering, Spotted, without_pose};
use crate::mask::MaskFile;
use crate::parsed::{ParsedScene, Posed};
use crate::reader::{Reader, sift};
use crate::{SceneError, pose, source_files};
use formats::{Bounds, Camera, Lens};
use page::{Frame, Page};

pub(crate) use write::frame;
pub use write::write_transforms;

/// What to do where photos are not found.
const REMEDY: &str = "the frames of the file name photos relative to its folder";

/// A scene whose cameras stand in a JSON file, or in a folder with `transforms.json`, or with
/// `transforms_train.json` and `transforms_test.json` (or, where that is missing,
/// `transforms_val.json`).
///
/// Photos are those that the frames name, with or without extension; frames without a photo are
/// left out, and noted. What the source sets aside for testing, by file or by nerfstudio's lists,
/// is in [`crate::SceneData::test`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transforms {
    /// The folder or the file.
    pub path: PathBuf,
    /// Width and height of all photos; by default those of the files.
    pub size: Option<(u32, u32)>,
    /// The scene box, in the file's own coordinates; by default what the file says.
    pub bounds: Option<Bounds>,
    /// Only every so many of the photos that the scene sets aside for testing; 0 and 1 take all.
    pub test_every: u32,
}

/// Photos of one file.
struct TransformsFile {
    path: PathBuf,
    page: Page,
    photos: Vec<(String, Posed)>,
    /// Whether the file says all near and far.
    ranged: bool,
    notes: Vec<String>,
}

impl Reader for Transforms {
    fn parse(&self) -> Result<ParsedScene, SceneError> {
        source_files::check_size(&self.path, self.size)?;
        place::check_box(&self.path, self.bounds.as_ref())?;
        let (mut parts, mut notes) = self.parts()?;
        parts
            .iter_mut()
            .for_each(|part| notes.append(&mut part.notes));
        let ranged = parts.iter().all(|part| part.ranged);
        let sources = parts.iter().map(|part| part.path.clone()).collect();
        let mut parts = parts.into_iter();
        let first = parts.next().ok_or_else(|| self.nothing())?;
        // Lists stand in the first file; a second one is held out as a whole.
        let mut split = splits::split(&first.page, first.photos, &mut notes);
        if split.train.is_empty() {
            let fault = "leaves no photo to train on";
            return Err(SceneError::content(&first.path, "train_filenames", fault));
        }
        split
            .test
            .extend(parts.flat_map(|part| part.photos).map(|(_, posed)| posed));
        let splits::Split {
            mut train,
            mut test,
        } = split;
        notes.extend(sift(&first.path, &mut train, &mut test, self.size)?);
        let step = self.test_every.max(1) as usize;
        // After `sift`, so that strays do not count among them.
        let test: Vec<Posed> = test.into_iter().step_by(step).collect();
        let counts = (train.len(), test.len());
        let mut scene = place::Placed { train, test };
        let box_of_file = place::bounds(&first.path, &first.page, self.bounds)?;
        // After `sift`, since a stray would widen the box of all frusta.
        let bounds = scene.settle(&first.path, box_of_file, ranged, &mut notes)?;
        let (bounds, to_source) = scene.recentre(bounds, &mut notes);
        let name = self.path.file_name().unwrap_or_default();
        Ok(ParsedScene {
            sources,
            description: format!(
                "{}: {} photos, {} set aside",
                name.to_string_lossy(),
                counts.0,
                counts.1
            ),
            train: scene.train,
            test: scene.test,
            bounds,
            to_source,
            size: self.size,
            notes,
        })
    }
}

impl Transforms {
    /// Names of all fields of the JSON that are read, and of those that are passed over without a
    /// word, since they say nothing about what a camera sees. Any other is noted.
    pub fn known_fields() -> (Vec<&'static str>, Vec<&'static str>) {
        Page::known_fields()
    }

    fn nothing(&self) -> SceneError {
        let remedy =
            "point to a folder with transforms.json or transforms_train.json, or to such a file";
        SceneError::Missing {
            path: self.path.join("transforms.json"),
            expected: "the cameras' file",
            remedy: remedy.into(),
        }
    }

    /// The file, or one file for each split as NeRF-synthetic has it, and what is noteworthy about
    /// there being others.
    fn parts(&self) -> Result<(Vec<TransformsFile>, Vec<String>), SceneError> {
        let beside = |name: &str| Some(self.path.join(name)).filter(|path| path.is_file());
        let whole = beside("transforms.json");
        // A file that is named is all that is meant, whatever lies beside it.
        if self.path.is_file() {
            return Ok((vec![TransformsFile::read(&self.path, true)?], Vec::new()));
        }
        let Some(train) = beside("transforms_train.json") else {
            let whole = whole.ok_or_else(|| self.nothing())?;
            return Ok((vec![TransformsFile::read(&whole, true)?], Vec::new()));
        };
        let mut notes = Vec::new();
        if whole.is_some() {
            notes.push(
                "transforms.json is not read, since transforms_train.json is beside it".into(),
            );
        }
        let mut parts = vec![TransformsFile::read(&train, false)?];
        let held_out = beside("transforms_test.json").or_else(|| {
            let validation = beside("transforms_val.json");
            notes.push(match validation {
                Some(_) => "there is no transforms_test.json: the photos of transforms_val.json are held out".into(),
                None => "there is neither transforms_test.json nor transforms_val.json beside it".into(),
            });
            validation
        });
        if let Some(held_out) = held_out {
            parts.push(TransformsFile::read(&held_out, false)?);
        }
        Ok((parts, notes))
    }
}

impl TransformsFile {
    /// Reads a file and finds its photos; `alone` if no other file names photos beside them.
    fn read(path: &Path, alone: bool) -> Result<TransformsFile, SceneError> {
        let page = Page::read(path)?;
        let mut part = TransformsFile {
            path: path.to_owned(),
            photos: Vec::new(),
            ranged: true,
            notes: Vec::new(),
            page,
        };
        part.gather(alone)?;
        if !part.page.unused.is_empty() {
            part.notes.push(format!(
                "not used of {}: {}",
                path.display(),
                part.page.unused.join(", ")
            ));
        }
        Ok(part)
    }

    fn gather(&mut self, alone: bool) -> Result<(), SceneError> {
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let paths: Vec<&str> = self
            .page
            .frames
            .iter()
            .map(|frame| frame.file_path.as_str())
            .collect();
        let mut gathering = Gathering::default();
        let mut faults = Faults::default();
        let mut used = Vec::new();
        for (frame, name) in self
            .page
            .frames
            .iter()
            .zip(source_files::view_names(&paths))
        {
            let Some(spotted) = gathering.find(folder, &frame.file_path)? else {
                continue;
            };
            // Before its pose is looked at: a bad one is reported as a fault, not as missing.
            used.push(spotted.file.clone());
            let camera = match camera(&self.page, frame, spotted.header.size) {
                Ok((camera, has_range)) => {
                    // One frame without a range is enough: all get theirs by one rule.
                    self.ranged &= has_range;
                    camera
                }
                Err(fault) => {
                    faults.add(format!("frame {:?}", frame.file_path), fault);
                    continue;
                }
            };
            let (camera, turn) = gathering.fit(&camera, &spotted)?;
            let mask = mask(&gathering, folder, frame, &spotted, &mut self.notes);
            let posed = Posed {
                name,
                file: spotted.file,
                camera,
                turn,
                mask,
            };
            self.photos.push((frame.file_path.clone(), posed));
        }
        self.notes.extend(gathering.settle(REMEDY)?);
        self.notes.extend(faults.settle(&self.path, paths.len())?);
        if alone {
            let masks = self
                .photos
                .iter()
                .filter_map(|(_, posed)| posed.mask.as_ref());
            // Masks may lie among the photos, and have no pose.
            let masks: Vec<PathBuf> = masks.map(|mask| mask.path.clone()).collect();
            self.notes
                .extend(without_pose(&beside(&used)?, used.iter().chain(&masks)));
        }
        Ok(())
    }
}

/// All photos in the folders of photos.
fn beside(photos: &[PathBuf]) -> Result<Vec<PathBuf>, SceneError> {
    let folders: BTreeSet<&Path> = photos.iter().filter_map(|photo| photo.parent()).collect();
    let lists = folders.into_iter().map(finder::list);
    Ok(lists.collect::<Result<Vec<_>, _>>()?.concat())
}

fn mask(
    gathering: &Gathering,
    folder: &Path,
    frame: &Frame,
    spotted: &Spotted,
    notes: &mut Vec<String>,
) -> Option<MaskFile> {
    if let Some(named) = &frame.mask_path {
        match gathering.finder.find(folder, named).photo() {
            Some(path) => return Some(MaskFile::black_is_out(path)),
            None => notes.push(format!(
                "the mask {named} of {} is missing",
                frame.file_path
            )),
        }
    }
    MaskFile::of(&gathering.finder, folder, &spotted.file, &frame.file_path)
}

/// The camera of a frame whose photo has this size, and whether the file says its near and far.
fn camera(page: &Page, frame: &Frame, size: (u32, u32)) -> Result<(Camera, bool), String> {
    let (own, matrix) = frame.camera.clone()?;
    let stated = own.or(&page.lens);
    let Lens {
        w, h, near, far, ..
    } = stated.lens;
    let width = side(w, size.0).ok_or("w is not a whole number of pixels")?;
    let height = side(h, size.1).ok_or("h is not a whole number of pixels")?;
    if let (Some(near), Some(far)) = (near, far)
        && !(near > 0.0 && near < far && far.is_finite())
    {
        return Err(format!("near {near} and far {far} are not 0 < near < far"));
    }
    let [fl_x, fl_y] = stated.focal([width, height])?;
    let camera = Camera {
        width,
        height,
        fl_x,
        fl_y,
        // A file that says nothing means the middle.
        cx: stated.lens.cx.unwrap_or(0.5 * f64::from(width)),
        cy: stated.lens.cy.unwrap_or(0.5 * f64::from(height)),
        distortion: stated.distortion()?,
        camera_to_world: pose::rigid(&matrix)
            .map_err(|fault| format!("transform_matrix {fault}"))?,
        // Stand-ins until the box or all cameras tell: a camera needs a range.
        near: near.unwrap_or(1.0),
        far: far.unwrap_or(2.0),
    };
    pose::check(&camera)?;
    Ok((camera, near.is_some() && far.is_some()))
}

/// The stated count of pixels, or else that of the photo; `None` if no image is so large.
fn side(stated: Option<u32>, found: u32) -> Option<u32> {
    stated.map_or(Some(found), |stated| {
        Some(stated).filter(|side| (1..=65536).contains(side))
    })
}

/// The cameras of a file's frames, in its order, whether their photos are there or not. Where the
/// file gives no size, near or far, those of `like` serve.
pub(crate) fn cameras_of_file(path: &Path, like: &Camera) -> Result<Vec<Camera>, SceneError> {
    let page = Page::read(path)?;
    let one = |frame: &Frame| {
        let (camera, has_range) =
            camera(&page, frame, (like.width, like.height)).map_err(|fault| {
                SceneError::content(path, format!("frame {:?}", frame.file_path), fault)
            })?;
        // Half a range is none.
        let [near, far] = match has_range {
            true => [camera.near, camera.far],
            false => [like.near, like.far],
        };
        Ok(Camera {
            near,
            far,
            ..camera
        })
    };
    page.frames.iter().map(one).collect()
}
