//! Where in the world a scene in `transforms.json` is: its box, the near and far of its cameras,
//! and a move to the origin where it is far from there. Knows no photos.

use std::path::Path;

use formats::{Bounds, Camera};
use glam::{DMat4, DVec3};

use super::page::Page;
use crate::parsed::Posed;
use crate::{SceneError, plausible, pose};

/// instant-ngp's defaults for `scale` and `offset`, by which it brings scenes into its unit cube.
const SCALE: f64 = 0.33;
const OFFSET: [f64; 3] = [0.5; 3];

/// Photos whose cameras are brought into place.
pub(super) struct Placed {
    pub(super) train: Vec<Posed>,
    pub(super) test: Vec<Posed>,
}

impl Placed {
    fn cameras(&self) -> Vec<Camera> {
        let all = self.train.iter().chain(&self.test);
        all.map(|posed| posed.camera).collect()
    }

    fn cameras_mut(&mut self) -> impl Iterator<Item = &mut Camera> {
        let all = self.train.iter_mut().chain(&mut self.test);
        all.map(|posed| &mut posed.camera)
    }

    /// Gives all cameras a near and far where the file does not say them all (`ranged`), and the
    /// scene a box.
    pub(super) fn settle(
        &mut self,
        path: &Path,
        bounds: Option<Bounds>,
        ranged: bool,
        notes: &mut Vec<String>,
    ) -> Result<Bounds, SceneError> {
        let cameras = self.cameras();
        if let Some(bounds) = &bounds {
            // Before anything is computed: a box that no camera sees trains to black.
            notes.extend(unseen(path, bounds, &cameras)?);
        }
        if !ranged {
            let guess = pose::guess_depths(&cameras);
            if bounds.is_none() {
                notes.push(format!(
                    "the file gives no scene box (`aabb_scale`): taken from the cameras alone, near {:.3} and far {:.3}; \
                     set `bounds` if it does not fit",
                    guess[0], guess[1]
                ));
            }
            // All of them, so that ranges of two origins are not mixed.
            for camera in self.cameras_mut() {
                let range = bounds
                    .as_ref()
                    .map_or(guess, |bounds| pose::depths_of_box(camera, bounds));
                [camera.near, camera.far] = range;
            }
        }
        // Held-out cameras have no say in the box.
        let train: Vec<Camera> = self.train.iter().map(|posed| posed.camera).collect();
        Ok(bounds.unwrap_or_else(|| pose::hull(&train)))
    }

    /// Moves a scene that is far from the origin there, in double precision. Gives the box after
    /// that, and the matrix that leads back.
    pub(super) fn recentre(&mut self, bounds: Bounds, notes: &mut Vec<String>) -> (Bounds, DMat4) {
        let Some(to_source) = plausible::recentred(&self.cameras()) else {
            return (bounds, DMat4::IDENTITY);
        };
        let middle = to_source.w_axis.truncate();
        let scale = 1.0 / to_source.x_axis.x;
        notes.push(format!(
            "the cameras stand about ({:.1}, {:.1}, {:.1}), far from the origin: coordinates are moved there and scaled \
             by {scale:.6}; what is exported goes back",
            middle.x, middle.y, middle.z
        ));
        for camera in self.cameras_mut() {
            // In double precision; fields compute in single, which would round positions away.
            *camera = camera.moved(DMat4::from_translation(-middle), scale);
        }
        let moved = bounds.map(|corner| ((DVec3::from(corner) - middle) * scale).to_array());
        (moved, to_source)
    }
}

/// An error if no camera sees the box, a note if most do not.
fn unseen(path: &Path, bounds: &Bounds, cameras: &[Camera]) -> Result<Option<String>, SceneError> {
    let blind = cameras
        .iter()
        .filter(|camera| !pose::sees_box(camera, bounds))
        .count();
    let focus = pose::focus(cameras);
    let [low, high] = bounds;
    let remedy = format!(
        "the cameras look at about ({:.2}, {:.2}, {:.2}): set `bounds` of the source to a box around that, or `aabb_scale`, \
         `scale` and `offset` in the file",
        focus.x, focus.y, focus.z
    );
    if blind == cameras.len() {
        let fault = format!("{low:.3?} to {high:.3?} is seen by no camera; {remedy}");
        return Err(SceneError::content(path, "the scene box", fault));
    }
    let note = || {
        format!(
            "{blind} of {} cameras see nothing of the scene box {low:.3?} to {high:.3?}; {remedy}",
            cameras.len()
        )
    };
    // A few cameras may look past the box.
    Ok((2 * blind > cameras.len()).then(note))
}

/// The box that the options or the file say, if they do.
pub(super) fn bounds(
    path: &Path,
    page: &Page,
    asked: Option<Bounds>,
) -> Result<Option<Bounds>, SceneError> {
    check_box(path, page.aabb.as_ref())?;
    // What the pipeline says comes first: it is how a wrong box in a file is mended.
    match asked.or(page.aabb) {
        Some(bounds) => Ok(Some(bounds)),
        None => cube(path, page),
    }
}

/// instant-ngp's cube in the file's coordinates. Without `aabb_scale` only a NeRF-synthetic file,
/// which has a field of view and no focal length, means it.
fn cube(path: &Path, page: &Page) -> Result<Option<Bounds>, SceneError> {
    let of_synthetic = page.has_field_of_view_alone().then_some(1.0);
    let Some(side) = page.aabb_scale.or(of_synthetic) else {
        return Ok(None);
    };
    let scale = page.scale.unwrap_or(SCALE);
    let offset = page.offset.unwrap_or(OFFSET);
    // The inverse of instant-ngp's p scale + offset, whose cube lies about 0.5.
    let bounds = [-0.5, 0.5].map(|half| offset.map(|offset| (0.5 + half * side - offset) / scale));
    check_box(path, Some(&bounds))?;
    Ok(Some(bounds))
}

/// Refuses a box that is none.
pub(super) fn check_box(path: &Path, bounds: Option<&Bounds>) -> Result<(), SceneError> {
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
