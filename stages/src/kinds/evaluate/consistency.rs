//! Whether a field shows the same from one held-out view as from the next. Knows nothing of the
//! truth.

use formats::Camera;
use glam::DVec3;
use metrics::{Image, Surface, Warped};
use nerf::Rendered;

use super::scores::Scored;

/// A view of a field, with its depth.
pub struct Shown {
    /// Whence it is seen.
    pub camera: Camera,
    /// Colour, depth and opacity.
    pub image: Rendered,
}

impl Shown {
    fn surface(&self) -> Surface<'_> {
        let width = self.image.width as usize;
        let height = self.image.height as usize;
        Surface {
            image: Image::new(width, height, &self.image.rgb),
            depth: &self.image.depth,
            opacity: &self.image.opacity,
        }
    }
}

/// How well one view agrees with another.
pub fn warped(source: &Shown, target: &Shown) -> [Scored; 2] {
    let project = |x: f64, y: f64, depth: f64| {
        // The field's own depth, so that only its agreement with itself is measured.
        let point = source.camera.unproject(x, y, depth);
        target.camera.project(point)
    };
    let Warped { psnr, coverage } = metrics::warped(source.surface(), target.surface(), project);
    let hidden = || "nothing that one view shows is seen from the next".to_owned();
    [
        ("psnr_warped", psnr.ok_or_else(hidden)),
        ("coverage_warped", Ok(coverage)),
    ]
}

/// The other camera that stands nearest; the first of several.
pub fn nearest(cameras: &[Camera], at: usize) -> Option<usize> {
    let position = |camera: usize| -> DVec3 { cameras[camera].position() };
    let distance = |other: &usize| position(*other).distance_squared(position(at));
    let others = (0..cameras.len()).filter(|other| *other != at);
    others.min_by(|a, b| distance(a).total_cmp(&distance(b)))
}
