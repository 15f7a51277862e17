//! Numbers in 16 bits: Adam's moments, and values as look-ups read them. Knows nothing of what they
//! are the moments of.
//!
//! Both moments keep the range of an f32, so that no gradient is too small. The first moves by a
//! tenth of what is new, and eight significant bits (bfloat16) do for it. The second moves by a
//! hundredth and must not stand still for being rounded: it has no sign, and gets nine.

use half::f16;

/// Lower bits of an f32 that a first moment goes without.
pub const FIRST: u32 = 16;
/// Lower bits of an f32 that a second moment goes without; its sign is not kept either.
pub const SECOND: u32 = 15;

/// Moments as they are kept: the upper bits, rounded to the nearest, halfway to even.
#[inline(always)]
pub fn pack<const DROPPED: u32>(moments: &[f32], packed: &mut [u16]) {
    for (packed, x) in packed.iter_mut().zip(moments) {
        let bits = x.to_bits();
        // Just below half of the last bit kept, and that bit itself: ties go to even.
        let rounded = bits.wrapping_add((1 << (DROPPED - 1)) - 1 + (bits >> DROPPED & 1));
        *packed = (rounded >> DROPPED) as u16;
    }
}

/// Moments as they are reckoned with.
#[inline(always)]
pub fn unpack<const DROPPED: u32>(packed: &[u16], moments: &mut [f32]) {
    moments
        .iter_mut()
        .zip(packed)
        .for_each(|(x, &packed)| *x = f32::from_bits(u32::from(packed) << DROPPED));
}

/// The nearest half, halfway to even; what is too large becomes the largest half.
#[inline(always)]
fn half(x: f32) -> u16 {
    /// Added to a number below 2^-14, it leaves no bits but those that a half of it has.
    const SMALL: f32 = 0.5;
    const LARGEST: f32 = 65504.0;
    // By hand, since the library's conversion is a call for every eight numbers.
    let size = x.abs().min(LARGEST);
    let bits = size.to_bits();
    // The exponents' biases differ by 112; a fraction loses 13 bits.
    let normal = (bits + 0xfff + (bits >> 13 & 1)) >> 13;
    // Below 2^-14 halves are not normal: an addition rounds to the bits that they have.
    let half = if size < 6.103_515_6e-5 {
        (size + SMALL).to_bits() - SMALL.to_bits()
    } else {
        normal - (112 << 10)
    };
    half as u16 | (x.to_bits() >> 16) as u16 & 0x8000
}

/// Values as look-ups read them.
#[inline(always)]
pub fn pack_halves(values: &[f32], halves: &mut [f16]) {
    halves
        .iter_mut()
        .zip(values)
        .for_each(|(packed, &x)| *packed = f16::from_bits(half(x)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn kept<const DROPPED: u32>(x: f32) -> (u16, f32) {
        let mut packed = [0];
        let mut back = [0.0];
        pack::<DROPPED>(&[x], &mut packed);
        unpack::<DROPPED>(&packed, &mut back);
        (packed[0], back[0])
    }

    proptest! {
        #[test]
        fn the_nearest_is_kept(x in -1e30..1e30f32, exponent in -30..0) {
            let x = x * 10f32.powi(exponent);
            prop_assert!((kept::<FIRST>(x).1 - x).abs() <= x.abs() / 256.0);
            prop_assert!((kept::<SECOND>(x.abs()).1 - x.abs()).abs() <= x.abs() / 512.0);
        }

        #[test]
        fn what_was_kept_is_kept_as_it_is(bits in 0..0x7f80u16) {
            let x = f32::from_bits(u32::from(bits) << FIRST);
            prop_assert_eq!((kept::<FIRST>(x), kept::<FIRST>(-x).0), ((bits, x), bits | 0x8000));
            let x = f32::from_bits(u32::from(2 * bits + 1) << SECOND);
            prop_assert_eq!(kept::<SECOND>(x), (2 * bits + 1, x));
        }

        #[test]
        fn halves_are_the_nearest(x in -7e4..7e4f32, exponent in -10..0) {
            let x = (x * 10f32.powi(exponent)).clamp(-65504.0, 65504.0);
            prop_assert_eq!(f16::from_bits(super::half(x)), f16::from_f32(x), "{}", x);
        }

        #[test]
        fn a_second_moment_without_a_gradient_dies_away(x in 1e-30..1e30f32) {
            let x = kept::<SECOND>(x).1;
            let next = kept::<SECOND>(0.99 * x).1;
            prop_assert!(0.98 * x < next && next < 0.994 * x, "{x} {next}");
        }
    }
}
