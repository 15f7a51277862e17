//! Near and far of photos from the sparse points that they show. Knows no files.

use std::collections::BTreeMap;

use formats::Camera;
use glam::DVec3;

use super::model::Model;
use crate::parsed::Posed;
use crate::pose;

/// Depths below and above these percentiles are taken for mistakes, as in LLFF.
const PERCENTILES: [f64; 2] = [0.1, 99.9];
/// Fewer points in a photo say nothing about its near and far.
const FEWEST_POINTS: usize = 8;
/// Where each point must be looked for in each photo, so many are enough.
const ENOUGH_POINTS: usize = 20_000;
/// What stands for a near and far that is not known yet.
const UNKNOWN: [f64; 2] = [0.0; 2];

/// Gives photos, known by their numbers, the near and far of the points found in them. Where points
/// do not say in which photos they were found, all that lie in a photo's view count, and a note
/// says so.
pub(super) fn set(model: &Model, photos: &mut [(u32, Posed)]) -> Option<String> {
    // Programs that do not triangulate write their points without tracks.
    let tracked = model.points.iter().any(|point| !point.seen_in.is_empty());
    let mut known = by_tracks(model);
    for (number, Posed { camera, .. }) in photos {
        let range = match tracked {
            true => known.remove(number).and_then(range),
            false => range(in_view(model, camera)),
        };
        [camera.near, camera.far] = range.unwrap_or(UNKNOWN);
    }
    (!tracked && !model.points.is_empty()).then(|| {
        "the sparse points do not say which photos show them (they have no tracks): near and far are taken from all points \
         in each photo's view"
            .into()
    })
}

/// Gives photos that show too few points the widest range of the others. If no photo shows enough,
/// cameras alone must tell, and a note says so.
pub(super) fn guess(photos: &mut [Posed]) -> Option<String> {
    let range_of = |posed: &Posed| [posed.camera.near, posed.camera.far];
    let known = photos
        .iter()
        .map(range_of)
        .filter(|range| *range != UNKNOWN);
    let widest = known.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    let cameras: Vec<Camera> = photos.iter().map(|posed| posed.camera).collect();
    let range = widest.unwrap_or_else(|| pose::guess_depths(&cameras));
    for posed in photos {
        if range_of(posed) == UNKNOWN {
            [posed.camera.near, posed.camera.far] = range;
        }
    }
    widest.is_none().then(|| {
        "no photo shows enough sparse points: near and far are taken from the cameras alone".into()
    })
}

/// Depths of the points found in each image.
fn by_tracks(model: &Model) -> BTreeMap<u32, Vec<f64>> {
    let mut seen: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for point in &model.points {
        for number in &point.seen_in {
            let pose = model.images.get(number).map(|image| &image.camera_to_world);
            // A photo may be left out, or its pose be none, while points still name it.
            let Some(Ok(pose)) = pose else {
                continue;
            };
            // A rigid pose: along the view axis is along -z, from the camera's position.
            let back = pose.z_axis.truncate();
            let depth = -back.dot(DVec3::from(point.position) - pose.w_axis.truncate());
            if depth > 0.0 && depth.is_finite() {
                seen.entry(*number).or_default().push(depth);
            }
        }
    }
    seen
}

/// Depths of the points that lie in a camera's view.
fn in_view(model: &Model, camera: &Camera) -> Vec<f64> {
    let step = model.points.len().div_ceil(ENOUGH_POINTS).max(1);
    let inside = |[px, py, depth]: [f64; 3]| {
        let [width, height] = [camera.width, camera.height].map(f64::from);
        let seen = (0.0..=width).contains(&px) && (0.0..=height).contains(&py);
        (seen && depth.is_finite()).then_some(depth)
    };
    // Every so many of them: near and far are percentiles, which a sample gives as well.
    let points = model.points.iter().step_by(step);
    points
        .filter_map(|point| camera.project(point.position).and_then(inside))
        .collect()
}

fn range(mut depths: Vec<f64>) -> Option<[f64; 2]> {
    if depths.len() < FEWEST_POINTS {
        return None;
    }
    // Sorted, so that the order of points in the file changes no bit.
    depths.sort_by(f64::total_cmp);
    let [near, far] = PERCENTILES.map(|percent| percentile(&depths, percent));
    // Points at one depth give no range; the other photos' range is taken then.
    (near < far).then_some([near, far])
}

/// The value below which so many percent of sorted values lie, interpolated linearly as NumPy does.
fn percentile(sorted: &[f64], percent: f64) -> f64 {
    let at = percent / 100.0 * (sorted.len() - 1) as f64;
    let below = at.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + at.fract() * (sorted[above] - sorted[below])
}
