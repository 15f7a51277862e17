//! Whether a render agrees with what it was made from. Knows nothing of held-out photos.

use crate::{Image, psnr};
use compute::Device;
use compute::resize::{Filter, resize};

/// PSNR in dB of `render`, reduced to the size of `low_resolution`, against it; see [`psnr`].
///
/// Reduced by the filter that made the low-resolution inputs: bicubic (a = -0.5) widened against
/// aliasing, on sRGB-encoded numbers clamped to 0..1 before and after. Needs no high-resolution
/// truth; a drift in brightness or invented structure shows here. Bounded by the inputs' own 8-bit
/// rounding, about 59 dB.
pub fn psnr_lr_consistency(render: Image, low_resolution: Image) -> f64 {
    let planes = (0..3)
        .flat_map(|channel| render.channel(channel))
        .map(|value| value as f32)
        .collect();
    // [1, 3, H, W]
    let full = Device::cpu().array(&[1, 3, render.height(), render.width()], planes);
    let width = low_resolution.width();
    let height = low_resolution.height();
    // Antialiased, as the inputs were: without it even a perfect render would alias and score low.
    // On the CPU, so that figures of fields from different devices compare.
    let reduced = resize(&full, height, width, Filter::BicubicPil, true).to_vec();
    let pixels = width * height;
    let rgb: Vec<f32> = (0..pixels * 3)
        .map(|i| reduced[i % 3 * pixels + i / 3])
        .collect();
    psnr(low_resolution, Image::new(width, height, &rgb))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_render_brighter_by_a_tenth_is_20_db_off_at_any_scale() {
        let render = vec![0.5f32; 32 * 24 * 3];
        let low = vec![0.4f32; 8 * 6 * 3];
        let value = psnr_lr_consistency(Image::new(32, 24, &render), Image::new(8, 6, &low));
        assert!((value - 20.0).abs() < 1e-4, "{value}");
    }

    /// Detail that the low resolution cannot hold costs nothing: a fine checkerboard reduces to its
    /// mean.
    #[test]
    fn detail_above_the_low_resolution_is_free() {
        let board: Vec<f32> = (0..32 * 32 * 3)
            .map(|i| ((i / 3 % 32 + i / 96) % 2) as f32 * 0.5 + 0.25)
            .collect();
        let low = vec![0.5f32; 8 * 8 * 3];
        let value = psnr_lr_consistency(Image::new(32, 32, &board), Image::new(8, 8, &low));
        assert!(value > 35.0, "{value}");
    }
}
