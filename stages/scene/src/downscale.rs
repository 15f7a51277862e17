//! Makes smaller photos of the same view. Knows nothing of scenes or files.
//!
//! Filters act on sRGB-encoded values, as image tools and the super-resolution literature do:
//! diffusion upscalers are trained on low-resolution images made so, and a bicubic kernel rings
//! less in encoded values than around highlights in linear light. Whoever judges consistency with
//! the low-resolution photos must shrink in the same way.

use compute::Device;
use compute::resize::{Filter, resize};
use formats::pixels::{interleaved, planes};
use formats::{Camera, Pixels, Srgb};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Photo, SceneError, mask};

/// The filter that makes low-resolution photos.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Reducer {
    /// Antialiased cubic convolution with a = -0.5, as PIL's.
    #[default]
    Bicubic,
    /// The mean of the pixels' areas.
    Area,
}

/// The photo at `1 / factor` of its size, rounded down on each axis, with the camera to match.
///
/// The new pixels divide the *whole* image plane evenly: at 252x189 a factor of 4 gives 63x47
/// pixels, each 4 wide and 189/47 high, and the intrinsics are scaled per axis by just that. The
/// view of the world stays exactly the same. Values are clamped to 0..=1, since bicubic kernels
/// overshoot.
pub fn downscale(photo: &Photo, factor: u32, filter: Reducer) -> Result<Photo, SceneError> {
    let Camera { width, height, .. } = photo.camera;
    let size = (
        width.checked_div(factor).unwrap_or(0),
        height.checked_div(factor).unwrap_or(0),
    );
    if size.0 == 0 || size.1 == 0 {
        let what = format!(
            "{}: {width}x{height} reduced by a factor of {factor}",
            photo.name
        );
        return Err(SceneError::EmptyImage {
            what,
            size,
            remedy: "choose a factor from 1 up to the shorter side",
        });
    }
    Ok(Photo {
        name: photo.name.clone(),
        camera: photo.camera.scaled(size.0, size.1),
        pixels: shrink_covered(&photo.pixels, (width, height), size, filter),
        mask: photo
            .mask
            .as_ref()
            .map(|mask| mask::reduced(mask, (width, height), size)),
    })
}

/// Resizes colours and their coverage. What is filtered are colours *times* coverage, so that what
/// a transparent pixel would be does not bleed over the edge: before any background the result is
/// the reduced image.
pub(crate) fn shrink_covered(
    pixels: &Pixels<Srgb>,
    size: (u32, u32),
    new_size: (u32, u32),
    filter: Reducer,
) -> Pixels<Srgb> {
    let Pixels { rgb, alpha, .. } = pixels;
    // At the same size nothing is filtered, and dividing by coverage would only round.
    let Some(alpha) = alpha.as_ref().filter(|_| size != new_size) else {
        return Pixels::new(shrink(rgb, 3, size, new_size, filter), alpha.clone());
    };
    // Times coverage, so that nothing bleeds out of transparent pixels.
    let covered: Vec<f32> = rgb
        .iter()
        .enumerate()
        .map(|(i, value)| value * alpha[i / 3])
        .collect();
    let alpha = shrink(alpha, 1, size, new_size, filter);
    let covered = shrink(&covered, 3, size, new_size, filter);
    let straight = |(i, value): (usize, f32)| {
        // Where coverage is 0 so is the colour, and nothing is divided.
        if value > 0.0 {
            // Colour and coverage overshoot alike but not equally, so the ratio may exceed 1.
            (value / alpha[i / 3]).min(1.0)
        } else {
            0.0
        }
    };
    let rgb = covered.into_iter().enumerate().map(straight).collect();
    Pixels::new(rgb, Some(alpha))
}

/// Resizes interleaved values `[height, width, channels]` to another size with antialiasing,
/// clamped to 0..=1.
pub(crate) fn shrink(
    values: &[f32],
    channels: usize,
    (width, height): (u32, u32),
    (new_width, new_height): (u32, u32),
    filter: Reducer,
) -> Vec<f32> {
    if (width, height) == (new_width, new_height) {
        return values.to_vec();
    }
    let filter = match filter {
        Reducer::Bicubic => Filter::BicubicPil,
        Reducer::Area => Filter::Area,
    };
    let planes = planes(values, channels);
    // On the CPU whatever the device, so that the scene's bits do not depend on it.
    let image = Device::cpu().array(&[1, channels, height as usize, width as usize], planes);
    let resized = resize(
        &image,
        new_height as usize,
        new_width as usize,
        filter,
        true,
    )
    .to_vec();
    interleaved(&resized, channels)
        .into_iter()
        // Bicubic kernels have negative parts and overshoot at edges.
        .map(|value| value.clamp(0.0, 1.0))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use formats::Distortion;
    use glam::DMat4;

    fn photo(width: u32, height: u32, value: impl Fn(u32, u32, usize) -> f32) -> Photo {
        let camera = Camera {
            width,
            height,
            fl_x: 300.0,
            fl_y: 301.0,
            cx: 0.48 * f64::from(width),
            cy: 0.51 * f64::from(height),
            distortion: Distortion::default(),
            camera_to_world: DMat4::IDENTITY,
            near: 1.0,
            far: 2.0,
        };
        let at = |i: u32, channel| value(i % width, i / width, channel);
        let rgb = (0..width * height)
            .flat_map(|i| [at(i, 0), at(i, 1), at(i, 2)])
            .collect();
        Photo {
            name: "p".into(),
            camera,
            pixels: Pixels::opaque(rgb),
            mask: None,
        }
    }

    #[test]
    fn the_area_filter_takes_the_mean_of_each_block() {
        let small = downscale(
            &photo(4, 2, |x, y, c| (x + 4 * y + 8 * c as u32) as f32 / 32.0),
            2,
            Reducer::Area,
        );
        let small = small.unwrap();
        assert_eq!((small.camera.width, small.camera.height), (2, 1));
        let mean = |x: f32, c: f32| (x + 2.5 + 8.0 * c) / 32.0;
        for (got, want) in small.pixels.rgb.iter().zip(
            [0.0, 2.0]
                .into_iter()
                .flat_map(|x| [0.0, 1.0, 2.0].map(|c| mean(x, c))),
        ) {
            assert!((got - want).abs() < 1e-6, "{got} {want}");
        }
    }

    #[test]
    fn sizes_that_do_not_divide_show_the_same_view() {
        let large = photo(252, 189, |_, _, _| 0.5);
        let small = downscale(&large, 4, Reducer::Bicubic).unwrap();
        assert_eq!((small.camera.width, small.camera.height), (63, 47));
        assert_eq!(small.pixels.rgb.len(), 63 * 47 * 3);
        for (a, b) in large
            .camera
            .frustum_corners()
            .into_iter()
            .zip(small.camera.frustum_corners())
        {
            assert!(
                glam::DVec3::from(a).distance(b.into()) < 1e-12,
                "{a:?} {b:?}"
            );
        }
        assert!(
            small.pixels.rgb.iter().all(|v| (v - 0.5).abs() < 1e-6),
            "a grey photo stays grey"
        );
    }

    #[test]
    fn a_ramp_stays_where_the_camera_says_it_is() {
        // Brightness is the image plane's own height; it must be so after shrinking by 189 / 47
        // too.
        let large = photo(16, 189, |_, y, _| (y as f32 + 0.5) / 189.0);
        let small = downscale(&large, 4, Reducer::Bicubic).unwrap();
        for y in 2..45usize {
            let want = (y as f32 + 0.5) / 47.0;
            assert!((small.pixels.rgb[y * 4 * 3] - want).abs() < 1e-4, "row {y}");
        }
    }

    #[test]
    fn bicubic_overshoot_is_clamped() {
        let edge = photo(64, 4, |x, _, _| if x < 31 { 0.0 } else { 1.0 });
        let small = downscale(&edge, 4, Reducer::Bicubic).unwrap();
        assert!(small.pixels.rgb.iter().all(|v| (0.0..=1.0).contains(v)));
    }

    #[test]
    fn factors_that_leave_no_pixels_are_refused() {
        for factor in [0, 5] {
            let message = downscale(&photo(8, 4, |_, _, _| 0.0), factor, Reducer::Area)
                .unwrap_err()
                .to_string();
            assert!(
                message.contains(&format!("p: 8x4 reduced by a factor of {factor}")),
                "{message}"
            );
        }
    }
}
