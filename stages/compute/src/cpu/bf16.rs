//! Numbers rounded to bf16, two to a word, as dot products of pairs take them.

/// The 32 bits of `lower` and `upper`, each rounded to the nearest bf16, ties to even.
#[inline(always)]
pub fn pair(lower: f32, upper: f32) -> f32 {
    f32::from_bits(rounded(lower) >> 16 | rounded(upper) & 0xffff_0000)
}

/// The bits of `x`, whose upper half is its bf16; NaN stays NaN.
#[inline(always)]
fn rounded(x: f32) -> u32 {
    let bits = x.to_bits();
    if x.is_nan() {
        bits | 0x0040_0000
    } else {
        bits.wrapping_add(0x7fff + (bits >> 16 & 1))
    }
}

#[cfg(test)]
mod tests {
    use super::pair;

    #[test]
    fn a_pair_rounds_as_the_half_crate_does() {
        for bits in (0..=u32::MAX).step_by(65_521) {
            let x = f32::from_bits(bits);
            let y = f32::from_bits(bits.rotate_left(7));
            let [lower, upper] = [x, y].map(|x| u32::from(half::bf16::from_f32(x).to_bits()));
            let got = pair(x, y).to_bits();
            let same = |x: f32, got: u32, expected: u32| {
                got == expected || x.is_nan() && got & 0x7fff > 0x7f80
            };
            assert!(
                same(x, got & 0xffff, lower) && same(y, got >> 16, upper),
                "{x} and {y} give {got:#x}"
            );
        }
    }
}
