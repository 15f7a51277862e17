//! Reads an LLFF scene: `poses_bounds.npy` beside folders of photos. Knows nothing of what is done
//! with it.
//!
//! Each row of the table is a 3x5 row-major matrix `[R | t | (h, w, f)]` and then near and far.
//! `R`'s columns are the camera's *down, right and backwards* axes; h, w and f belong to the
//! full-size photos, whatever size lies beside them. Near and far are percentiles of visible
//! depths, so they hold no outliers.

use std::path::{Path, PathBuf};

use formats::npy::{NpyError, Table, read_table};
use formats::{Camera, Distortion};
use glam::{DMat4, DVec3};

use crate::faults::a_tenth;
use crate::finder;
use crate::folders;
use crate::gathering::{Gathering, SAME_SHAPE, Spotted};
use crate::mask::MaskFile;
use crate::normalize::normalize;
use crate::parsed::{ParsedScene, Posed};
use crate::photo_file;
use crate::reader::{Reader, sift};
use crate::{SceneError, pose, source_files};

const POSES_FILE: &str = "poses_bounds.npy";
const COLUMNS: usize = 17;
const EXPECTED: &str =
    "an N x 17 array of little-endian f64 in C order: per photo a 3x5 pose, near and far";
/// Rotations farther than this from orthonormal are not rotations. Files in single precision are
/// within 1e-6.
const ORTHONORMAL: f64 = 1e-3;

/// A folder in the LLFF layout.
///
/// Photos of another size are resized by an antialiased bicubic filter (see [`crate::downscale`]
/// for the colour space); intrinsics follow exactly. The scene is moved into its average camera's
/// frame with the nearest near plane at depth 1 (`docs/conventions.md`); its box is the hull of all
/// frusta.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Llff {
    /// The folder.
    pub folder: PathBuf,
    /// The subfolder of photos; by default the smallest of `images`, `images_2`, `images_4`, ...
    /// that has all photos and is not below `size`, or the largest.
    pub images: Option<String>,
    /// Width and height of all photos; by default those of the files.
    pub size: Option<(u32, u32)>,
}

impl Reader for Llff {
    fn parse(&self) -> Result<ParsedScene, SceneError> {
        source_files::check_size(&self.folder, self.size)?;
        let poses_file = self.folder.join(POSES_FILE);
        if !poses_file.is_file() {
            return Err(SceneError::Missing {
                path: poses_file,
                expected: "the table of camera poses",
                remedy: "point to an LLFF scene's folder, or make the file with LLFF's imgs2poses"
                    .into(),
            });
        }
        let photos = folders::choose(&self.folder, self.images.as_deref(), self.size, &[])?;
        let files = finder::list(&photos.folder)?;
        let poses = read_poses(&poses_file)?;
        // Rows have no names: only their order ties them to photos, so one too many shifts all.
        if files.len() != poses.rows {
            return Err(SceneError::Count {
                folder: photos.folder,
                images: files.len(),
                poses_file,
                poses: poses.rows,
            });
        }
        let mut notes: Vec<String> = photos.note.into_iter().collect();
        let mut train = self.gather(&poses_file, &poses, files, &mut notes)?;
        let mut test = Vec::new();
        notes.extend(sift(&poses_file, &mut train, &mut test, self.size)?);
        let cameras: Vec<Camera> = train.iter().map(|posed| posed.camera).collect();
        let (moved, to_source) = normalize(&cameras);
        let bounds = pose::hull(&moved);
        for (posed, camera) in train.iter_mut().zip(moved) {
            posed.camera = camera;
        }
        let first = &train[0].camera;
        let size = self.size.unwrap_or((first.width, first.height));
        Ok(ParsedScene {
            description: self.describe(&photos.folder, train.len(), size),
            sources: vec![poses_file],
            train,
            test,
            bounds,
            to_source,
            size: Some(size),
            notes,
        })
    }
}

impl Llff {
    /// The photos with the cameras of their rows. Rows that are none are left out, up to a tenth of
    /// them.
    fn gather(
        &self,
        poses_file: &Path,
        poses: &Table,
        files: Vec<PathBuf>,
        notes: &mut Vec<String>,
    ) -> Result<Vec<Posed>, SceneError> {
        let size = one_size(&files)?;
        let names = names(&files);
        let count = files.len();
        let mut gathering = Gathering::default();
        let mut faults = Vec::new();
        let mut photos = Vec::new();
        let rows = poses.values.chunks_exact(COLUMNS).enumerate();
        for ((row, values), (file, name)) in rows.zip(files.into_iter().zip(names)) {
            let camera = match camera(values, size).and_then(|camera| {
                pose::check(&camera)?;
                Ok(camera)
            }) {
                Ok(camera) => camera,
                Err(fault) => {
                    faults.push((row, fault));
                    continue;
                }
            };
            let header = photo_file::header(&file)?;
            let spotted = Spotted { file, header };
            let (camera, turn) = gathering.fit(&camera, &spotted)?;
            let file = spotted.file;
            let mask = MaskFile::of(&gathering.finder, &self.folder, &file, &file_name(&file));
            photos.push(Posed {
                name,
                file,
                camera,
                turn,
                mask,
            });
        }
        // As in `Faults::settle`: a tenth may be bad, more mean another layout.
        if faults.len() > a_tenth(count) || photos.is_empty() {
            let (row, fault) = faults.swap_remove(0);
            return Err(SceneError::Pose {
                path: poses_file.into(),
                row,
                fault,
            });
        }
        notes.extend(faults.iter().map(|(row, fault)| {
            format!(
                "{}: row {row} (counted from 0) and its photo are left out: {fault}",
                poses_file.display()
            )
        }));
        notes.extend(gathering.notes());
        Ok(photos)
    }

    fn describe(&self, images: &Path, count: usize, (width, height): (u32, u32)) -> String {
        format!(
            "LLFF scene {}: {count} photos from {}, {width}x{height}; average camera at the origin, nearest near plane at 1",
            file_name(&self.folder),
            file_name(images)
        )
    }
}

fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

fn names(files: &[PathBuf]) -> Vec<String> {
    let names: Vec<String> = files.iter().map(|file| file_name(file)).collect();
    source_files::view_names(&names.iter().map(String::as_str).collect::<Vec<_>>())
}

/// The one size that all photos have, from their headers, before any of them is decoded.
fn one_size(files: &[PathBuf]) -> Result<(u32, u32), SceneError> {
    let sizes = files
        .iter()
        .map(|file| photo_file::size(file))
        .collect::<Result<Vec<_>, _>>()?;
    match sizes.iter().position(|size| *size != sizes[0]) {
        None => Ok(sizes[0]),
        Some(odd) => Err(SceneError::MixedSizes {
            path: files[odd].clone(),
            size: sizes[odd],
            first: files[0].clone(),
            first_size: sizes[0],
        }),
    }
}

fn read_poses(path: &Path) -> Result<Table, SceneError> {
    let table = read_table(path).map_err(|error| match error {
        NpyError::Io(source) => SceneError::io(path, source),
        NpyError::Content(fault) => SceneError::Npy {
            path: path.into(),
            fault,
            expected: EXPECTED,
        },
    })?;
    if table.columns != COLUMNS || table.rows == 0 {
        let fault = format!("the array is {} x {}", table.rows, table.columns);
        return Err(SceneError::Npy {
            path: path.into(),
            fault,
            expected: EXPECTED,
        });
    }
    Ok(table)
}

/// One row of the table as a camera for photos of `size`, in OpenGL axes.
fn camera(row: &[f64], size: (u32, u32)) -> Result<Camera, String> {
    if let Some(bad) = row.iter().position(|value| !value.is_finite()) {
        return Err(format!("value {bad} is {}", row[bad]));
    }
    // The 3x5 pose lies row by row: numbers i, i + 5 and i + 10 are column i.
    let column = |i: usize| DVec3::new(row[i], row[i + 5], row[i + 10]);
    let down = column(0);
    let right = column(1);
    let back = column(2);
    let position = column(3);
    let [full_height, full_width, focal] = column(4).to_array();
    // LLFF's columns are down, right, backwards; ours right, up, backwards.
    check_rotation(right, -down, back)?;
    check_intrinsics((full_width, full_height), focal, size)?;
    let near = row[15];
    let far = row[16];
    // NaN was refused above, so the comparisons hold for all numbers.
    if near <= 0.0 || near >= far {
        return Err(format!("near {near} and far {far} are not 0 < near < far"));
    }
    let width = f64::from(size.0);
    let height = f64::from(size.1);
    Ok(Camera {
        width: size.0,
        height: size.1,
        // Each axis by its own ratio: reduced copies are rounded to whole pixels on each.
        fl_x: focal * width / full_width,
        fl_y: focal * height / full_height,
        // The table has no principal point: LLFF takes the middle.
        cx: width / 2.0,
        cy: height / 2.0,
        distortion: Distortion::default(),
        camera_to_world: DMat4::from_cols(
            right.extend(0.0),
            (-down).extend(0.0),
            back.extend(0.0),
            position.extend(1.0),
        ),
        near,
        far,
    })
}

fn check_rotation(right: DVec3, up: DVec3, back: DVec3) -> Result<(), String> {
    let lengths = [right, up, back].map(|axis| (axis.length() - 1.0).abs());
    // Right x up = backwards also fails for axes that are skewed or mirrored.
    let skew = right.cross(up).distance(back);
    let off = lengths.into_iter().fold(skew, f64::max);
    if off < ORTHONORMAL {
        return Ok(());
    }
    Err(format!(
        "its rotation's columns are not orthonormal axes [down, right, backwards] (off by {off:.3})"
    ))
}

fn check_intrinsics(full: (f64, f64), focal: f64, size: (u32, u32)) -> Result<(), String> {
    if full.0 <= 0.0 || full.1 <= 0.0 || focal <= 0.0 {
        return Err(format!(
            "width {}, height {} and focal length {focal} are not all positive",
            full.0, full.1
        ));
    }
    let shrunk_x = f64::from(size.0) / full.0;
    let shrunk_y = f64::from(size.1) / full.1;
    if (shrunk_x / shrunk_y - 1.0).abs() > SAME_SHAPE {
        return Err(format!(
            "its poses belong to photos of {}x{}, the photos are {}x{}: another aspect ratio",
            full.0, full.1, size.0, size.1
        ));
    }
    Ok(())
}
