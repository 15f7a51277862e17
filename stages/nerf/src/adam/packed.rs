//! Adam's moments in 16 bits. Knows numbers, and nothing of what they are the moments of.
//!
//! Both keep the range of an f32, so that no gradient is too small. The first moment moves by a tenth of what is new, and
//! eight significant bits (bfloat16) do for it. The second moves by a hundredth and must not stand still for being
//! rounded: it has no sign, and gets nine.

use half::f16;

/// How many of an f32's bits are dropped.
const FIRST: u32 = 16;
const SECOND: u32 = 15;

/// The upper bits of a number, rounded to the nearest, halfway to even.
#[inline(always)]
fn upper<const DROPPED: u32>(x: f32) -> u16 {
    let bits = x.to_bits();
    (bits.wrapping_add((1 << (DROPPED - 1)) - 1 + (bits >> DROPPED & 1)) >> DROPPED) as u16
}

/// First moments as they are kept.
#[inline(always)]
pub fn pack_first(moments: &[f32], packed: &mut [u16]) {
    packed.iter_mut().zip(moments).for_each(|(packed, &x)| *packed = upper::<FIRST>(x));
}

/// First moments as they are reckoned with.
#[inline(always)]
pub fn unpack_first(packed: &[u16], moments: &mut [f32]) {
    moments.iter_mut().zip(packed).for_each(|(x, &packed)| *x = f32::from_bits(u32::from(packed) << FIRST));
}

/// Second moments as they are kept.
#[inline(always)]
pub fn pack_second(moments: &[f32], packed: &mut [u16]) {
    packed.iter_mut().zip(moments).for_each(|(packed, &x)| *packed = upper::<SECOND>(x));
}

/// Second moments as they are reckoned with.
#[inline(always)]
pub fn unpack_second(packed: &[u16], moments: &mut [f32]) {
    moments.iter_mut().zip(packed).for_each(|(x, &packed)| *x = f32::from_bits(u32::from(packed) << SECOND));
}

/// The nearest half, halfway to even; what is too large becomes the largest half.
#[inline(always)]
fn half(x: f32) -> u16 {
    /// Added to a number below 2^-14, it leaves no bits but those that a half of it has.
    const SMALL: f32 = 0.5;
    const LARGEST: f32 = 65504.0;
    let size = x.abs().min(LARGEST);
    let bits = size.to_bits();
    let normal = (bits + 0xfff + (bits >> 13 & 1)) >> 13;
    let half = if size < 6.103_515_6e-5 { (size + SMALL).to_bits() - SMALL.to_bits() } else { normal - (112 << 10) };
    half as u16 | (x.to_bits() >> 16) as u16 & 0x8000
}

/// Values as look-ups read them.
#[inline(always)]
pub fn pack_halves(values: &[f32], halves: &mut [f16]) {
    halves.iter_mut().zip(values).for_each(|(packed, &x)| *packed = f16::from_bits(half(x)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn first(x: f32) -> (u16, f32) {
        let (mut packed, mut back) = ([0], [0.0]);
        pack_first(&[x], &mut packed);
        unpack_first(&packed, &mut back);
        (packed[0], back[0])
    }

    fn second(x: f32) -> (u16, f32) {
        let (mut packed, mut back) = ([0], [0.0]);
        pack_second(&[x], &mut packed);
        unpack_second(&packed, &mut back);
        (packed[0], back[0])
    }

    proptest! {
        #[test]
        fn the_nearest_is_kept(x in -1e30..1e30f32, exponent in -30..0) {
            let x = x * 10f32.powi(exponent);
            prop_assert!((first(x).1 - x).abs() <= x.abs() / 256.0);
            prop_assert!((second(x.abs()).1 - x.abs()).abs() <= x.abs() / 512.0);
        }

        #[test]
        fn what_was_kept_is_kept_as_it_is(bits in 0..0x7f80u16) {
            let x = f32::from_bits(u32::from(bits) << FIRST);
            prop_assert_eq!((first(x), first(-x).0), ((bits, x), bits | 0x8000));
            let x = f32::from_bits(u32::from(2 * bits + 1) << SECOND);
            prop_assert_eq!(second(x), (2 * bits + 1, x));
        }

        #[test]
        fn halves_are_the_nearest(x in -7e4..7e4f32, exponent in -10..0) {
            let x = (x * 10f32.powi(exponent)).clamp(-65504.0, 65504.0);
            prop_assert_eq!(f16::from_bits(super::half(x)), f16::from_f32(x), "{}", x);
        }

        #[test]
        fn a_second_moment_without_a_gradient_dies_away(x in 1e-30..1e30f32) {
            let x = second(x).1;
            let next = second(0.99 * x).1;
            prop_assert!(0.98 * x < next && next < 0.994 * x, "{x} {next}");
        }
    }
}
