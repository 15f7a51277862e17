//! Reads an LLFF scene: `poses_bounds.npy` beside folders of photos. Knows nothing of what is done with it.
//!
//! Each row of the table is a 3x5 row-major matrix `[R | t | (h, w, f)]` and then near and far. `R`'s columns are the
//! camera's *down, right and backwards* axes; h, w and f belong to the full-size photos, whatever size lies beside
//! them. Near and far are percentiles of visible depths, so they hold no outliers.

use std::path::Path;

use glam::{DMat4, DVec3};

use crate::llff_files::{self, LlffFiles};
use crate::normalize::normalize;
use crate::npy::{Table, read_table};
use crate::photo::bounding_box;
use crate::source_files::{self, Posed, SAME_SHAPE};
use crate::{Camera, Distortion, SceneData, SceneError};

const COLUMNS: usize = 17;
const EXPECTED: &str =
    "an N x 17 array of little-endian f64 in C order: per photo a 3x5 pose, near and far";
/// Rotations farther than this from orthonormal are not rotations. Files in single precision are within 1e-6.
const ORTHONORMAL: f64 = 1e-3;

/// Reads the LLFF scene in `folder`.
///
/// `images` names the subfolder of photos; without it the smallest of `images`, `images_2`, `images_4`, ... that is not
/// below `size` is taken, or the largest there is. Photos of another size are resized by an antialiased bicubic filter
/// (see [`crate::downscale`] for the colour space); intrinsics follow exactly. The scene is moved into its average
/// camera's frame with the nearest near plane at depth 1 (`docs/conventions.md`); its box is the hull of all frusta.
///
/// # Errors
/// Every way in which the folder can be unfit, as a [`SceneError`] that names the file.
pub fn llff(
    folder: &Path,
    images: Option<&str>,
    size: Option<(u32, u32)>,
) -> Result<SceneData, SceneError> {
    let (files, cameras) = survey(folder, images, size)?;
    let cameras = normalize(&cameras);
    let target_size = size.unwrap_or((cameras[0].width, cameras[0].height));
    let photos: Vec<Posed> = files
        .photos
        .iter()
        .zip(&cameras)
        .map(|(file, camera)| posed(file, camera))
        .collect();
    Ok(SceneData {
        photos: source_files::read_photos(&photos, Some(target_size))?,
        test: Vec::new(),
        bounds: bounding_box(cameras.iter().flat_map(Camera::frustum_corners)),
        description: describe(folder, &files, target_size),
        notes: Vec::new(),
    })
}

/// Everything that can be known without decoding a photo: the files, and the cameras in their own coordinates.
pub(crate) fn survey(
    folder: &Path,
    images: Option<&str>,
    size: Option<(u32, u32)>,
) -> Result<(LlffFiles, Vec<Camera>), SceneError> {
    source_files::check_size(folder, size)?;
    let files = llff_files::find(folder, images, size)?;
    let poses = read_poses(&files.poses)?;
    check_count(&files, poses.rows)?;
    let cameras = cameras(&files.poses, &poses, llff_files::one_size(&files.photos)?)?;
    Ok((files, cameras))
}

fn check_count(files: &LlffFiles, poses: usize) -> Result<(), SceneError> {
    let images = files.photos.len();
    if images == poses {
        return Ok(());
    }
    Err(SceneError::Count {
        folder: files.folder.clone(),
        images,
        poses_file: files.poses.clone(),
        poses,
    })
}

fn describe(folder: &Path, files: &LlffFiles, (width, height): (u32, u32)) -> String {
    let name = |path: &Path| {
        path.file_name()
            .map(|n| n.to_string_lossy().into_owned())
            .unwrap_or_default()
    };
    format!(
        "LLFF scene {}: {} photos from {}, {width}x{height}; average camera at the origin, nearest near plane at 1",
        name(folder),
        files.photos.len(),
        name(&files.folder)
    )
}

fn read_poses(path: &Path) -> Result<Table, SceneError> {
    let table = read_table(path, EXPECTED)?;
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

fn cameras(path: &Path, poses: &Table, size: (u32, u32)) -> Result<Vec<Camera>, SceneError> {
    let faulty = |row, fault| SceneError::Pose {
        path: path.into(),
        row,
        fault,
    };
    let rows = poses.values.chunks_exact(COLUMNS).enumerate();
    rows.map(|(row, values)| camera(values, size).map_err(|fault| faulty(row, fault)))
        .collect()
}

/// One row of the table as a camera for photos of `size`, in OpenGL axes.
fn camera(row: &[f64], size: (u32, u32)) -> Result<Camera, String> {
    if let Some(bad) = row.iter().position(|value| !value.is_finite()) {
        return Err(format!("value {bad} is {}", row[bad]));
    }
    let column = |i: usize| DVec3::new(row[i], row[i + 5], row[i + 10]);
    let (down, right, back, position) = (column(0), column(1), column(2), column(3));
    let [full_height, full_width, focal] = column(4).to_array();
    check_rotation(right, -down, back)?;
    check_intrinsics((full_width, full_height), focal, size)?;
    let (near, far) = (row[15], row[16]);
    if near <= 0.0 || near >= far {
        return Err(format!("near {near} and far {far} are not 0 < near < far"));
    }
    let (width, height) = (f64::from(size.0), f64::from(size.1));
    Ok(Camera {
        width: size.0,
        height: size.1,
        fl_x: focal * width / full_width,
        fl_y: focal * height / full_height,
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
    let (shrunk_x, shrunk_y) = (f64::from(size.0) / full.0, f64::from(size.1) / full.1);
    if (shrunk_x / shrunk_y - 1.0).abs() > SAME_SHAPE {
        return Err(format!(
            "its poses belong to photos of {}x{}, the photos are {}x{}: another aspect ratio",
            full.0, full.1, size.0, size.1
        ));
    }
    Ok(())
}

fn posed(file: &Path, camera: &Camera) -> Posed {
    let name = file
        .file_stem()
        .map(|stem| stem.to_string_lossy().into_owned())
        .unwrap_or_default();
    Posed {
        name,
        file: file.to_owned(),
        camera: camera.clone(),
    }
}
