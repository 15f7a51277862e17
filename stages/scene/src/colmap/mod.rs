//! Reads a COLMAP reconstruction beside its photos. Knows nothing of what is done with it.
//!
//! Near and far of a photo are percentiles of the depths of the sparse points found in it, as
//! LLFF's are; the scene box is the hull of all frusta between them, and coordinates are those of
//! LLFF scenes (`docs/conventions.md`). Rigs and frames, of which newer versions write files as
//! well, are noted and passed over: every image has its own pose.

mod binary;
mod depths;
mod files;
mod model;
mod text;

use std::path::{Path, PathBuf};

use crate::faults::Faults;
use crate::finder;
use crate::folders;
use crate::gathering::{Gathering, without_pose};
use crate::mask::MaskFile;
use crate::normalize::normalize;
use crate::parsed::{ParsedScene, Posed};
use crate::reader::{Reader, sift};
use crate::{SceneError, pose, source_files};
use files::Reconstruction;
use formats::Camera;
use model::{Image, Model};

/// What to do where photos are not found.
const REMEDY: &str = "the reconstruction names photos in that folder; give another by `images`";

/// A folder with a COLMAP reconstruction and its photos.
///
/// The reconstruction, binary or text, lies in `sparse/0`, `sparse`, the same under `colmap` or
/// `dense`, or the folder itself; of several in `sparse` the one with the most photos is read.
/// Photos may be reduced copies and lie in folders within their folder. Photos of another size than
/// `size` are resized by an antialiased bicubic filter.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Colmap {
    /// The folder.
    pub folder: PathBuf,
    /// The subfolder of photos; by default the smallest of `images`, `images_2`, `images_4` … that
    /// has all photos and is not below `size`, or the largest.
    pub images: Option<String>,
    /// Width and height of all photos; by default those of the files.
    pub size: Option<(u32, u32)>,
}

impl Colmap {
    /// Whether a reconstruction lies in a folder, as far as names of files tell.
    pub fn is_in(folder: &Path) -> bool {
        files::are_in(folder)
    }

    /// How good the reconstruction in a folder is, by its own account. Looks for no photos.
    ///
    /// # Errors
    /// No reconstruction, or one whose files are damaged.
    pub fn registered(folder: &Path) -> Result<Registered, SceneError> {
        let model = files::read(folder)?.model;
        let errors = model.points.iter().map(|point| point.error);
        // Programs that do not triangulate write -1.
        let measured: Vec<f64> = errors.filter(|error| *error >= 0.0).collect();
        let mean = measured.iter().sum::<f64>() / measured.len() as f64;
        Ok(Registered {
            photos: model.images.len(),
            points: model.points.len(),
            error: (!measured.is_empty()).then_some(mean),
        })
    }
}

/// What a reconstruction has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registered {
    /// Photos whose poses are known.
    pub photos: usize,
    /// Sparse points of the reconstruction.
    pub points: usize,
    /// Their mean reprojection error in pixels, where it was measured.
    pub error: Option<f64>,
}

impl Reader for Colmap {
    fn parse(&self) -> Result<ParsedScene, SceneError> {
        source_files::check_size(&self.folder, self.size)?;
        let Reconstruction {
            sources,
            model,
            mut notes,
        } = files::read(&self.folder)?;
        let names: Vec<&str> = model
            .images
            .values()
            .map(|image| image.name.as_str())
            .collect();
        let photos = folders::choose(&self.folder, self.images.as_deref(), self.size, &names)?;
        notes.extend(photos.note);
        let file_of_images = sources[1].clone();
        let mut found = gather(
            &self.folder,
            &file_of_images,
            &model,
            &photos.folder,
            &mut notes,
        )?;
        // While the cameras are still in the points' coordinates.
        notes.extend(depths::set(&model, &mut found));
        let mut train: Vec<Posed> = found.into_iter().map(|(_, posed)| posed).collect();
        // By name, as the hold-out counts.
        train.sort_by(|a, b| a.name.cmp(&b.name));
        let mut test = Vec::new();
        notes.extend(sift(&file_of_images, &mut train, &mut test, self.size)?);
        // After `sift`: a camera that is left out must not widen the others' range.
        notes.extend(depths::guess(&mut train));
        let cameras: Vec<Camera> = train.iter().map(|posed| posed.camera).collect();
        // Only now, since the scale is that of the nearest near.
        let (moved, to_source) = normalize(&cameras);
        let bounds = pose::hull(&moved);
        for (posed, camera) in train.iter_mut().zip(moved) {
            posed.camera = camera;
        }
        let name = self.folder.file_name().unwrap_or_default();
        Ok(ParsedScene {
            description: format!(
                "COLMAP scene {}: {} photos; average camera at the origin, nearest near plane at 1",
                name.to_string_lossy(),
                train.len()
            ),
            sources,
            train,
            test,
            bounds,
            to_source,
            size: self.size,
            notes,
        })
    }
}

/// The registered photos that are there, by their numbers, in coordinates and with poses of the
/// reconstruction.
fn gather(
    scene: &Path,
    file_of_images: &Path,
    model: &Model,
    folder: &Path,
    notes: &mut Vec<String>,
) -> Result<Vec<(u32, Posed)>, SceneError> {
    let paths: Vec<&str> = model
        .images
        .values()
        .map(|image| image.name.as_str())
        .collect();
    let names = source_files::view_names(&paths);
    let mut gathering = Gathering::default();
    let mut faults = Faults::default();
    let mut found = Vec::new();
    let mut used = Vec::new();
    for ((number, image), name) in model.images.iter().zip(names) {
        let Some(spotted) = gathering.find(folder, &image.name)? else {
            continue;
        };
        // Before the pose is looked at: a bad one is reported as a fault, not as missing.
        used.push(spotted.file.clone());
        let camera = match camera(model, image) {
            Ok(camera) => camera,
            Err(fault) => {
                faults.add(&image.name, fault);
                continue;
            }
        };
        let (camera, turn) = gathering.fit(&camera, &spotted)?;
        let mask = MaskFile::of(&gathering.finder, scene, &spotted.file, &image.name);
        let posed = Posed {
            name,
            file: spotted.file,
            camera,
            turn,
            mask,
        };
        found.push((*number, posed));
    }
    notes.extend(gathering.settle(REMEDY)?);
    notes.extend(faults.settle(file_of_images, paths.len())?);
    notes.extend(without_pose(&finder::list_all(folder)?, used.iter()));
    Ok(found)
}

fn camera(model: &Model, image: &Image) -> Result<Camera, String> {
    let lens = model.lenses.get(&image.lens);
    let lens = lens.ok_or_else(|| format!("its camera {} is not among the cameras", image.lens))?;
    Ok(Camera {
        camera_to_world: image.camera_to_world.clone()?,
        ..*lens
    })
}
