//! Image sets as a scene on disk that other programs train on. Knows nothing of how they came
//! about.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;

use artifacts_schema::ImageSet;
use formats::rows;
use glam::DVec3;
use scene::{Capture, Layout, LayoutError, Part, Photo, Point};

use crate::error::StageError;
use crate::surface::{Surface, Vertex};
use crate::{convert, ply};

/// An image set to write: its artifact, and the folder whose EXR files are to be taken as they are.
#[derive(Clone, Copy)]
pub struct Exported<'s> {
    /// The artifact, as it was read.
    pub images: &'s ImageSet,
    /// The artifact's folder, if its EXR files are to stand in for PNGs.
    pub exr: Option<&'s Path>,
}

/// Writes image sets in the layout of another program, in the scene's own coordinates, with points
/// to begin with if there is a surface. Gives what was left out.
///
/// # Errors
/// If the layout cannot hold them, or the file system says no.
pub fn export(
    folder: &Path,
    layout: Layout,
    train: Exported,
    test: Option<Exported>,
    surface: &Surface,
) -> Result<Vec<String>, LayoutError> {
    let photos = |source: Exported| {
        source
            .images
            .views
            .iter()
            .map(convert::view_photo)
            .collect()
    };
    // Owned here, since the parts that are written borrow them.
    let [trained, held_out]: [Vec<Photo>; 2] =
        [Some(train), test].map(|source| source.map(photos).unwrap_or_default());
    let points: Vec<Point> = surface.vertices.iter().map(point).collect();
    let capture = Capture {
        train: part(&trained, Some(train)),
        test: part(&held_out, test),
        bounds: train.images.bounds,
        to_source: train.images.to_source.as_ref().map(rows::matrix),
        points: &points,
    };
    let notes = layout.write(folder, &capture)?;
    // Points are for splat trainers that begin from them; not every layout has a file for them.
    if let Some(file) = layout.points_file().filter(|_| !points.is_empty()) {
        let path = folder.join(file);
        write_points(&path, surface).map_err(|source| LayoutError::Write { path, source })?;
    }
    Ok(notes)
}

fn part<'p>(photos: &'p [Photo], source: Option<Exported<'p>>) -> Part<'p> {
    let exr = source.and_then(|source| source.exr);
    Part { photos, exr }
}

fn point(vertex: &Vertex) -> Point {
    Point {
        position: vertex.position,
        color: vertex.bytes(),
    }
}

fn write_points(path: &Path, surface: &Surface) -> std::io::Result<()> {
    let mut out = BufWriter::new(File::create(path)?);
    ply::write(surface, true, &mut out)?;
    out.flush()
}

/// Writes image sets in the layout of NeRF-synthetic (see [`scene::write_transforms`]); the
/// training set's box is the scene's. A scene that was moved to the origin, since its files'
/// coordinates are large, goes back to them.
///
/// # Errors
/// If the file system says no.
pub fn write(folder: &Path, train: &ImageSet, test: Option<&ImageSet>) -> Result<(), StageError> {
    // Both sets go back by the training set's shift, so that they stay in one system of
    // coordinates.
    let back = train.to_source.and_then(shift);
    let photos = |images: &ImageSet| {
        let photos = images.views.iter().map(convert::view_photo);
        photos
            .map(|photo| match back {
                Some((offset, scale)) => moved(photo, offset, scale),
                None => photo,
            })
            .collect::<Vec<Photo>>()
    };
    let bounds = match back {
        Some((offset, scale)) => train
            .bounds
            .map(|corner| (DVec3::from(corner) * scale + offset).to_array()),
        None => train.bounds,
    };
    Ok(scene::write_transforms(
        folder,
        &photos(train),
        &test.map(photos).unwrap_or_default(),
        bounds,
    )?)
}

/// The offset and the scale of a similarity without a turn; `None` for one that turns, by which an
/// axis-aligned box would not be one any more.
fn shift(to_source: [[f64; 4]; 4]) -> Option<(DVec3, f64)> {
    let scale = to_source[0][0];
    let is_plain =
        // Exactly: the matrix was made without a turn, so no rounding has touched its zeros.
        (0..3).all(|i| (0..3).all(|j| to_source[i][j] == if i == j { scale } else { 0.0 }));
    let offset = DVec3::new(to_source[0][3], to_source[1][3], to_source[2][3]);
    is_plain.then_some((offset, scale))
}

/// A photo in coordinates that are `scale` times as large and then moved by `offset`.
fn moved(mut photo: Photo, offset: DVec3, scale: f64) -> Photo {
    let camera = &mut photo.camera;
    let position = camera.position() * scale + offset;
    camera.camera_to_world.w_axis = position.extend(1.0);
    // Depths are lengths, and scale with the scene.
    camera.near *= scale;
    camera.far *= scale;
    photo
}
