//! Whether two rendered views show the same surface in the same colour. Knows nothing of cameras:
//! the caller maps a pixel and its depth in one view to a place and a depth in the other.

use crate::Image;
use crate::psnr::{from_mse, squared_difference};

/// Below this opacity a pixel shows no surface.
const OPAQUE: f32 = 0.5;
/// Depths that differ by more than this share of the target's belong to different surfaces.
const DEPTH_TOLERANCE: f64 = 0.02;

/// A rendered view: its colours, and per pixel the depth along the view axis and the opacity
/// (0..1), rows first.
#[derive(Clone, Copy)]
pub struct Surface<'a> {
    /// The colours of the rendered view.
    pub image: Image<'a>,
    /// Depth per pixel, in any unit the mapping understands.
    pub depth: &'a [f32],
    /// Opacity per pixel, 0..1.
    pub opacity: &'a [f32],
}

/// How well one view, carried into another by its own depth, agrees with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warped {
    /// PSNR in dB over the visible pixels ([`crate::psnr`]'s cap and clamp); `None` where nothing
    /// is visible.
    pub psnr: Option<f64>,
    /// The share of the source's pixels that are visible in the target, 0 to 1. Without it the PSNR
    /// says little: a small overlap is easily consistent.
    pub coverage: f64,
}

/// Compares each pixel of `source` with the place in `target` where its surface point lies.
///
/// `project(x, y, depth)` takes a pixel position in the source (centres at .5) and its depth, and
/// returns `[x, y, depth]` in the target, or `None` behind its camera. A pixel is visible if it is
/// opaque, lands among the centres of the target's pixels, and the target there is opaque and
/// equally deep within 2 % (the z-test: hidden surfaces drop out). Its colour is compared with the
/// target's, interpolated bilinearly. Panics if lengths and sizes differ.
pub fn warped(
    source: Surface,
    target: Surface,
    project: impl Fn(f64, f64, f64) -> Option<[f64; 3]>,
) -> Warped {
    source.assert_complete();
    target.assert_complete();
    let width = source.image.width();
    let height = source.image.height();
    let mut squares = 0.0;
    let mut visible = 0usize;
    // On one thread: the sum has one order.
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let Some([u, v, depth]) = source
            .point(x, y)
            .and_then(|[x, y, depth]| project(x, y, depth))
        else {
            continue;
        };
        if let Some(colour) = target.seen(u, v, depth) {
            let pairs = source.image.pixel(x, y).into_iter().zip(colour);
            squares += pairs.map(|(a, b)| squared_difference(a, b)).sum::<f64>();
            visible += 1;
        }
    }
    let psnr = (visible > 0).then(|| from_mse(squares / (3 * visible) as f64));
    Warped {
        psnr,
        coverage: visible as f64 / (width * height) as f64,
    }
}

impl Surface<'_> {
    fn assert_complete(&self) {
        let pixels = self.image.width() * self.image.height();
        let lengths = [self.depth.len(), self.opacity.len()];
        assert_eq!(
            lengths, [pixels; 2],
            "warped: depth and opacity need one number per pixel"
        );
    }

    /// The centre and depth of an opaque pixel.
    fn point(&self, x: usize, y: usize) -> Option<[f64; 3]> {
        let at = y * self.image.width() + x;
        let depth = f64::from(self.depth[at]);
        (self.opacity[at] >= OPAQUE && depth > 0.0).then_some([
            x as f64 + 0.5,
            y as f64 + 0.5,
            depth,
        ])
    }

    /// The colour at (`u`, `v`), if a surface at `depth` is what this view sees there.
    fn seen(&self, u: f64, v: f64, depth: f64) -> Option<[f32; 3]> {
        let width = self.image.width();
        let height = self.image.height();
        // Between centres: beyond them nothing is there to interpolate with.
        let inside = |at: f64, length: usize| (0.5..=length as f64 - 0.5).contains(&at);
        if !inside(u, width) || !inside(v, height) {
            return None;
        }
        // The depth of the pixel itself: a mean across a rim would be that of no surface.
        let [_, _, own] = self.point((u as usize).min(width - 1), (v as usize).min(height - 1))?;
        // Relative to the depth: the scene's unit does not matter.
        ((depth - own).abs() <= DEPTH_TOLERANCE * own).then(|| self.interpolated(u - 0.5, v - 0.5))
    }

    /// The bilinear colour at (`u`, `v`), counted from the first pixel's centre.
    fn interpolated(&self, u: f64, v: f64) -> [f32; 3] {
        let x = u as usize;
        let y = v as usize;
        // At the last centre the neighbour has no weight; the bound keeps the index inside.
        let right = (x + 1).min(self.image.width() - 1);
        let below = (y + 1).min(self.image.height() - 1);
        let s = (u - x as f64) as f32;
        let t = (v - y as f64) as f32;
        let mix =
            |a: [f32; 3], b: [f32; 3], s: f32| std::array::from_fn(|c| a[c] + s * (b[c] - a[c]));
        let top = mix(self.image.pixel(x, y), self.image.pixel(right, y), s);
        mix(
            top,
            mix(
                self.image.pixel(x, below),
                self.image.pixel(right, below),
                s,
            ),
            t,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 64;

    fn surface<'a>(rgb: &'a [f32], depth: &'a [f32], opacity: &'a [f32]) -> Surface<'a> {
        Surface {
            image: Image::new(8, 8, rgb),
            depth,
            opacity,
        }
    }

    /// Columns of brightness x / 8.
    fn ramp() -> Vec<f32> {
        (0..PIXELS * 3).map(|i| (i / 3 % 8) as f32 / 8.0).collect()
    }

    #[test]
    fn a_view_is_consistent_with_itself() {
        let rgb = ramp();
        let ones = vec![1.0; PIXELS];
        let view = surface(&rgb, &ones, &ones);
        let warped = warped(view, view, |x, y, depth| Some([x, y, depth]));
        assert_eq!(
            warped,
            Warped {
                psnr: Some(crate::MAX_PSNR),
                coverage: 1.0
            }
        );
    }

    /// Shifted by one and a half columns the ramp is off by 1.5 / 8 everywhere, and two of eight
    /// columns leave.
    #[test]
    fn a_shift_costs_what_the_ramp_says_and_covers_what_stays_inside() {
        let rgb = ramp();
        let ones = vec![1.0; PIXELS];
        let view = surface(&rgb, &ones, &ones);
        let warped = warped(view, view, |x, y, depth| Some([x + 1.5, y, depth]));
        assert_eq!(warped.coverage, 0.75);
        assert!(
            (warped.psnr.unwrap() + 20.0 * (1.5f64 / 8.0).log10()).abs() < 1e-6,
            "{warped:?}"
        );
    }

    #[test]
    fn hidden_transparent_and_unprojected_pixels_are_not_compared() {
        let rgb = ramp();
        let ones = vec![1.0; PIXELS];
        let black = vec![0.0; PIXELS * 3];
        let half: Vec<f32> = (0..PIXELS)
            .map(|i| if i < 32 { 1.0 } else { 0.4 })
            .collect();
        let view = surface(&rgb, &ones, &ones);
        let other = surface(&black, &ones, &half);
        let nothing = Warped {
            psnr: None,
            coverage: 0.0,
        };
        assert_eq!(
            warped(view, other, |x, y, depth| Some([x, y, 1.03 * depth])),
            nothing
        );
        assert_eq!(warped(view, other, |_, _, _| None), nothing);
        assert_eq!(
            warped(view, other, |x, y, depth| Some([x, y, 1.01 * depth])).coverage,
            0.5
        );
        assert_eq!(
            warped(other, view, |x, y, depth| Some([x, y, depth])).coverage,
            0.5
        );
    }
}
