//! The sRGB transfer function (IEC 61966-2-1), exact and piecewise. Knows nothing of primaries:
//! those of sRGB and of Rec. 709 are the same, so encoding is all that lies between our photos and
//! scene-linear EXR files.

/// Decodes an sRGB value to linear light. Both are 1 at reference white. Values below 0 mirror,
/// those above 1 follow the curve on, so that [`linear_to_srgb`] undoes it everywhere.
pub fn srgb_to_linear(encoded: f32) -> f32 {
    // Values below 0, as bicubic leaves them, are mirrored: a power of them would be NaN.
    let x = encoded.abs();
    // The standard's own constants; its two pieces do not quite meet, by some 1e-8.
    let linear = if x <= 0.04045 {
        x / 12.92
    } else {
        ((x + 0.055) / 1.055).powf(2.4)
    };
    linear.copysign(encoded)
}

/// Encodes linear light as an sRGB value. The inverse of [`srgb_to_linear`].
pub fn linear_to_srgb(linear: f32) -> f32 {
    let x = linear.abs();
    let encoded = if x <= 0.003_130_8 {
        x * 12.92
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    };
    encoded.copysign(linear)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        assert_eq!(srgb_to_linear(0.0), 0.0);
        assert!((srgb_to_linear(1.0) - 1.0).abs() < 1e-6);
        assert!((srgb_to_linear(0.5) - 0.214_041).abs() < 1e-6);
        assert!((linear_to_srgb(0.18) - 0.461_356).abs() < 1e-5);
        assert!(
            (linear_to_srgb(0.002) - 0.025_84).abs() < 1e-7,
            "the linear toe"
        );
    }

    #[test]
    fn every_eight_bit_value_survives_the_round_trip() {
        for byte in 0..=255u8 {
            let back = linear_to_srgb(srgb_to_linear(f32::from(byte) / 255.0)) * 255.0;
            assert!(
                (back - f32::from(byte)).abs() < 1e-3,
                "{byte} became {back}"
            );
        }
    }

    #[test]
    fn values_outside_zero_to_one_survive_too() {
        for x in [-0.7, -0.01, 1.5, 4.0] {
            assert!((linear_to_srgb(srgb_to_linear(x)) - x).abs() < 1e-5, "{x}");
        }
    }
}
