//! Photos as the field came to see them: from refined cameras, at one exposure. Knows nothing of
//! how either was learnt.

use artifacts_schema::{Log, View};
use formats::{Camera, Pixels, Srgb};
use nerf::{Exposure, WHITE};
use serde_json::json;

use crate::training::Trained;

/// A value that a photo cut off at white counts as cut off if undoing its exposure makes it darker
/// than white by more than this.
const CUT: f32 = 0.01;

/// The photo at this place with what training learnt about it: its camera as it is now, its exposure
/// undone. What was cut off at white, and is darker than that at the common exposure, is masked: a
/// photo does not know how bright it was.
pub fn photo(view: View, at: usize, trained: &Trained) -> View {
    let moved = View {
        camera: trained.cameras[at],
        ..view
    };
    match &trained.exposures {
        Some(exposures) => undone(moved, &exposures[at]),
        None => moved,
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
pub fn exposures(photos: &[(String, Camera)], exposures: &[Exposure]) -> Log {
    let line = |((name, _), exposure): (&(String, Camera), &Exposure)| {
        json!({
            "view": name,
            "gain": exposure.linear_gain.map(f64::from),
            "offset": exposure.offset().map(f64::from),
        })
    };
    Log {
        lines: photos.iter().zip(exposures).map(line).collect(),
    }
}

/// How far the camera that moved most is from where it was, over the distance that it looks at.
pub fn largest_shift(given: &[(String, Camera)], refined: &[Camera]) -> f64 {
    let shift = |((_, camera), refined): (&(String, Camera), &Camera)| {
        // The geometric mean of near and far stands for the distance: the two may be magnitudes
        // apart.
        camera.position().distance(refined.position()) / (camera.near * camera.far).sqrt()
    };
    given.iter().zip(refined).map(shift).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat4;

    fn view(rgb: Vec<f32>) -> View {
        let pixels: Pixels<Srgb> = Pixels::opaque(rgb);
        View {
            name: "a".into(),
            camera: Camera::centered((2, 1), 2.0, DMat4::IDENTITY, [1.0, 4.0]),
            pixels: pixels.linear(),
            depth: None,
            mask: None,
        }
    }

    #[test]
    fn exposures_are_undone_and_what_they_cut_off_is_masked() {
        let given = view(vec![0.5, 0.5, 0.5, 1.0, 0.5, 0.5]);
        let before = [("a".to_owned(), given.camera)];
        let mut camera = given.camera;
        camera.camera_to_world = DMat4::from_translation(glam::DVec3::X);
        let trained = Trained {
            cameras: vec![camera],
            exposures: Some(vec![Exposure {
                gain: [1.25; 3],
                ..Exposure::NONE
            }]),
        };
        let view = photo(given, 0, &trained);
        assert!(
            view.pixels.encoded().rgb[..3]
                .iter()
                .all(|x| (x - 0.4).abs() < 1e-5)
        );
        assert_eq!(view.mask, Some(vec![true, false]));
        assert_eq!(view.camera, camera);
        assert!((largest_shift(&before, &trained.cameras) - 0.5).abs() < 1e-12);
    }
}
