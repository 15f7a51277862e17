//! Factors rounded to bf16, two numbers to a word, as dot products of pairs take them.

use super::factor::TILE_STRIDE;
use super::tile::COLUMNS;
use crate::runtime::cpu::matrix::Matrix;
use crate::runtime::cpu::simd::vectorize;
use crate::runtime::format::Precision;

/// The 32 bits of `lower` and `upper`, each rounded to the nearest bf16, ties to even.
#[inline(always)]
fn pair(lower: f32, upper: f32) -> f32 {
    f32::from_bits(rounded(lower) >> 16 | rounded(upper) & 0xffff_0000)
}

/// The bits of `x`, whose upper half is its bf16; NaN stays NaN.
#[inline(always)]
fn rounded(x: f32) -> u32 {
    let bits = x.to_bits();
    if x.is_nan() {
        // Cut off, a NaN whose payload lies low would become infinity.
        bits | 0x0040_0000
    } else {
        // Just below half of the last bit kept, and that bit itself: ties go to even.
        bits.wrapping_add(0x7fff + (bits >> 16 & 1))
    }
}

/// In bf16, a panel becomes half as many rows of pairs, in place.
pub fn narrow_panel(panel: &mut [f32], precision: Precision) {
    if precision == Precision::F32 {
        return;
    }
    vectorize(
        #[inline(always)]
        || {
            for row in 0..(panel.len() / COLUMNS).div_ceil(2) {
                let lower = 2 * row * COLUMNS;
                let upper = (2 * row + 1) * COLUMNS;
                for column in 0..COLUMNS {
                    // An odd row has no partner; zeros add nothing.
                    let upper = if upper < panel.len() {
                        panel[upper + column]
                    } else {
                        0.0
                    };
                    panel[row * COLUMNS + column] = pair(panel[lower + column], upper);
                }
            }
        },
    );
}

/// In bf16, a tile becomes one of pairs, in `space`, with half as many columns.
pub fn narrow_tile<'a>(tile: Matrix<'a>, space: &'a mut [f32], precision: Precision) -> Matrix<'a> {
    if precision == Precision::F32 {
        return tile;
    }
    let row_stride = tile.row_stride;
    let step = tile.column_stride;
    let columns = tile.columns;
    let values = tile.values();
    vectorize(
        #[inline(always)]
        || {
            for (row, space) in space.chunks_mut(TILE_STRIDE).enumerate().take(tile.rows) {
                for (k, space) in space.iter_mut().enumerate().take(columns.div_ceil(2)) {
                    let at = row * row_stride + 2 * k * step;
                    let upper = if 2 * k + 1 < columns {
                        values[at + step]
                    } else {
                        0.0
                    };
                    *space = pair(values[at], upper);
                }
            }
        },
    );
    Matrix::strided(space, tile.rows, columns.div_ceil(2), TILE_STRIDE)
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
