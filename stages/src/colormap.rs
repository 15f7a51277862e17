//! Colours for numbers, such that equal steps look equal: a way through Oklab (Ottosson 2020,
//! <https://bottosson.github.io/posts/oklab>). Knows nothing of what the numbers mean.

use formats::color::linear_to_srgb;

/// Its name, for legends.
pub const NAME: &str = "Oklab, dark blue to bright yellow";
/// Lightness of 0 and of 1: even in between, so that a grey print still reads.
const LIGHTNESS: [f32; 2] = [0.22, 0.93];
/// Hue of 0 and of 1 in turns: from blue by red to yellow.
const HUE: [f32; 2] = [0.76, 1.29];
const CHROMA: f32 = 0.13;

/// The colour of a value from 0 to 1, sRGB-encoded; values beyond have the colours of the ends.
pub fn color(value: f32) -> [f32; 3] {
    // `clamp` lets NaN pass.
    let value = if value.is_nan() {
        0.0
    } else {
        value.clamp(0.0, 1.0)
    };
    // Hue may pass 1: sine and cosine do not care.
    let between = |[from, to]: [f32; 2]| from + value * (to - from);
    let (sin, cos) = (std::f32::consts::TAU * between(HUE)).sin_cos();
    oklab_to_srgb([between(LIGHTNESS), CHROMA * cos, CHROMA * sin])
}

/// The matrices are Ottosson's; what lies outside sRGB is clipped.
fn oklab_to_srgb([l, a, b]: [f32; 3]) -> [f32; 3] {
    // Oklab keeps cube roots of the cones' answers, since lightness is seen so.
    let cone = |a_part: f32, b_part: f32| (l + a_part * a + b_part * b).powi(3);
    let l = cone(0.396_337_78, 0.215_803_76);
    let m = cone(-0.105_561_346, -0.063_854_17);
    let s = cone(-0.089_484_18, -1.291_485_5);
    let linear = [
        4.076_741_7 * l - 3.307_711_6 * m + 0.230_969_94 * s,
        -1.268_438 * l + 2.609_757_4 * m - 0.341_319_4 * s,
        -0.004_196_086_3 * l - 0.703_418_6 * m + 1.707_614_7 * s,
    ];
    // Bright yellow and dark blue at this chroma may lie outside sRGB.
    linear.map(|value| linear_to_srgb(value.clamp(0.0, 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CIE lightness, by formulas that share nothing with Oklab.
    fn lightness(rgb: [f32; 3]) -> f32 {
        let [r, g, b] = rgb.map(formats::color::srgb_to_linear);
        116.0 * (0.2126 * r + 0.7152 * g + 0.0722 * b).cbrt() - 16.0
    }

    #[test]
    fn equal_steps_are_about_equally_lighter() {
        let steps: Vec<f32> = (0..=10)
            .map(|i| lightness(color(i as f32 / 10.0)))
            .collect();
        for pair in steps.windows(2) {
            assert!((4.0..12.0).contains(&(pair[1] - pair[0])), "{steps:?}");
        }
        assert!(steps[0] < 20.0 && steps[10] > 85.0, "{steps:?}");
    }

    #[test]
    fn white_and_black_are_where_oklab_has_them_and_the_ends_hold() {
        assert!(
            oklab_to_srgb([1.0, 0.0, 0.0])
                .iter()
                .all(|value| (value - 1.0).abs() < 1e-3)
        );
        assert_eq!(oklab_to_srgb([0.0; 3]), [0.0; 3]);
        for (value, end) in [(-1.0, 0.0), (2.0, 1.0), (f32::NAN, 0.0)] {
            // A sine that the compiler evaluates may differ from the processor's in its last bit.
            assert!(
                color(value)
                    .iter()
                    .zip(color(end))
                    .all(|(a, b)| (a - b).abs() < 1e-6),
                "{value}"
            );
        }
        let [r, g, b] = color(0.0);
        assert!(b > r && b > g, "dark blue");
        let [r, g, b] = color(1.0);
        assert!(r > b && g > b, "bright yellow");
    }
}
