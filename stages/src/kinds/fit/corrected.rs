//! Photos as the field came to see them: from refined cameras, at one exposure. Knows nothing of
//! how either was learnt.

use artifacts_schema::{ImageSet, Log, View};
use formats::{Camera, Pixels, Srgb};
use nerf::{Exposure, WHITE};
use serde_json::json;

use crate::training::Trained;

/// A value that a photo cut off at white counts as cut off if undoing its exposure makes it darker
/// than white by more than this.
const CUT: f32 = 0.01;

/// The photos with what training learnt about them: their cameras as they are now, their exposures
/// undone. What was cut off at white, and is darker than that at the common exposure, is masked: a
/// photo does not know how bright it was.
pub fn photos(images: &ImageSet, trained: &Trained) -> ImageSet {
    let exposures = trained.exposures.as_ref();
    let views = images.views.iter().zip(&trained.cameras).enumerate();
    let photo = |(i, (view, camera)): (usize, (&View, &Camera))| {
        let moved = View {
            camera: *camera,
            ..view.clone()
        };
        match exposures {
            Some(exposures) => undone(moved, &exposures[i]),
            None => moved,
        }
    };
    ImageSet {
        views: views.map(photo).collect(),
        ..*images
    }
}

/// A photo at the common exposure.
fn undone(view: View, exposure: &Exposure) -> View {
    let Pixels { rgb, alpha, .. } = view.pixels.encoded();
    let undone = |shown: &[f32; 3]| exposure.inverse(*shown);
    let shown = rgb.as_chunks().0;
    let is_told = |shown: &[f32; 3]| {
        let colors = shown.iter().zip(undone(shown));
        colors
            .into_iter()
            // A value below white was recorded, not cut off. One at white may stay if the common
            // exposure makes it as bright.
            .all(|(shown, color)| *shown < WHITE || color > 1.0 - CUT)
    };
    let open = |i: usize| view.mask.as_ref().is_none_or(|mask| mask[i]);
    let mask: Vec<bool> = (0..shown.len())
        .map(|i| open(i) && is_told(&shown[i]))
        .collect();
    let colors = shown
        .iter()
        .flat_map(undone)
        // Photos are from 0 to 1, and undoing an exposure may lead out of that.
        .map(|color| color.clamp(0.0, 1.0));
    let pixels: Pixels<Srgb> = Pixels::new(colors.collect(), alpha);
    View {
        pixels: pixels.linear(),
        // No mask is smaller than one in which all pixels count.
        mask: mask.contains(&false).then_some(mask),
        ..view
    }
}

/// How every photo was exposed, a line each: gains in linear light, and offsets in sRGB values.
pub fn exposures(images: &ImageSet, exposures: &[Exposure]) -> Log {
    let line = |(view, exposure): (&View, &Exposure)| {
        json!({
            "view": view.name,
            "gain": exposure.linear_gain.map(f64::from),
            "offset": exposure.offset().map(f64::from),
        })
    };
    Log {
        lines: images.views.iter().zip(exposures).map(line).collect(),
    }
}

/// How far the camera that moved most is from where it was, over the distance that it looks at.
pub fn largest_shift(given: &ImageSet, refined: &ImageSet) -> f64 {
    let shift = |(given, refined): (&View, &View)| {
        let camera = &given.camera;
        // The geometric mean of near and far stands for the distance: the two may be magnitudes
        // apart.
        camera.position().distance(refined.camera.position()) / (camera.near * camera.far).sqrt()
    };
    given
        .views
        .iter()
        .zip(&refined.views)
        .map(shift)
        .fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat4;

    fn set(rgb: Vec<f32>) -> ImageSet {
        let pixels: Pixels<Srgb> = Pixels::opaque(rgb);
        let camera = Camera::centered((2, 1), 2.0, DMat4::IDENTITY, [1.0, 4.0]);
        ImageSet {
            views: vec![View {
                name: "a".into(),
                camera,
                pixels: pixels.linear(),
                depth: None,
                mask: None,
            }],
            bounds: [[0.0; 3], [1.0; 3]],
            to_source: None,
        }
    }

    #[test]
    fn exposures_are_undone_and_what_they_cut_off_is_masked() {
        let images = set(vec![0.5, 0.5, 0.5, 1.0, 0.5, 0.5]);
        let mut camera = images.views[0].camera;
        camera.camera_to_world = DMat4::from_translation(glam::DVec3::X);
        let trained = Trained {
            cameras: vec![camera],
            exposures: Some(vec![Exposure {
                gain: [1.25; 3],
                ..Exposure::NONE
            }]),
        };
        let photos = photos(&images, &trained);
        let view = &photos.views[0];
        assert!(
            view.pixels.encoded().rgb[..3]
                .iter()
                .all(|x| (x - 0.4).abs() < 1e-5)
        );
        assert_eq!(view.mask, Some(vec![true, false]));
        assert_eq!(view.camera, camera);
        assert!((largest_shift(&images, &photos) - 0.5).abs() < 1e-12);
    }
}
