//! The 36 numbers NIQE takes from each block of a picture. Knows nothing of what they are compared
//! with.

use super::aggd::Shapes;
use super::pristine::{FEATURES, Pristine};
use super::scale_space::Plane;
use rayon::prelude::*;

/// The side of a block at full size; half of it at half size.
pub(super) const BLOCK: usize = 96;
/// Features of a block at each of the two scales.
const PER_SCALE: usize = FEATURES / 2;
/// Neighbours that coefficients are multiplied with: right, below, and both diagonals, as (rows,
/// columns) to roll by.
const SHIFTS: [(isize, isize); 4] = [(0, 1), (1, 0), (1, 1), (1, -1)];

/// The features of one block; NaN where a side of a distribution has no samples.
pub(super) type Features = [f64; FEATURES];

/// The features of `columns * rows` whole blocks of a luma plane (0..255), column by column.
pub(super) fn of_blocks(luma: Vec<f32>, columns: usize, rows: usize) -> Vec<Features> {
    let window = Pristine::read().window;
    let shapes = Shapes::new();
    let full = Plane {
        width: columns * BLOCK,
        values: luma,
    };
    // Halved before it is normalised: local means at half size are those of a wider area.
    let half = full.halved();
    let full = full.normalized(&window);
    let half = half.normalized(&window);
    let of_block = |block: usize| {
        // Column by column, as in BasicSR: means over blocks add up in this order.
        let column = block / rows;
        let row = block % rows;
        let [full, half] = [(&full, BLOCK), (&half, BLOCK / 2)].map(|(plane, side)| {
            at_scale(&shapes, &cut(plane, column * side, row * side, side), side)
        });
        std::array::from_fn(|i| {
            if i < PER_SCALE {
                full[i]
            } else {
                half[i - PER_SCALE]
            }
        })
    };
    (0..columns * rows).into_par_iter().map(of_block).collect()
}

/// The square of `side` at (`left`, `top`).
fn cut(plane: &Plane, left: usize, top: usize, side: usize) -> Vec<f32> {
    (top..top + side)
        .flat_map(|y| &plane.values[y * plane.width + left..][..side])
        .copied()
        .collect()
}

/// The 18 features of a block of normalised coefficients: shape and mean scale of the coefficients
/// themselves, then shape, mean and both scales of their products with each of four neighbours.
fn at_scale(shapes: &Shapes, block: &[f32], side: usize) -> [f64; PER_SCALE] {
    let own = shapes.fit(block.iter().copied());
    let mut features = [0.0; PER_SCALE];
    features[..2].copy_from_slice(&[own.alpha, (own.beta_left + own.beta_right) / 2.0]);
    for (quad, shift) in features[2..].chunks_mut(4).zip(SHIFTS) {
        let fit = shapes.fit(products(block, side, shift));
        quad.copy_from_slice(&[fit.alpha, fit.mean(), fit.beta_left, fit.beta_right]);
    }
    features
}

/// Each coefficient times the one `rows` above and `columns` to the left, wrapping around within
/// the block.
fn products(
    block: &[f32],
    side: usize,
    (rows, columns): (isize, isize),
) -> impl Iterator<Item = f32> {
    // No geometry, but what the reference's `np.roll` does within a block.
    let rolled = move |at: usize, by: isize| (at as isize - by).rem_euclid(side as isize) as usize;
    (0..side * side).map(move |at| {
        block[at] * block[rolled(at / side, rows) * side + rolled(at % side, columns)]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_wrap_around_within_the_block() {
        let block: Vec<f32> = (1..=9).map(|i| i as f32).collect();
        let right: Vec<f32> = products(&block, 3, (0, 1)).collect();
        assert_eq!(right, [3.0, 2.0, 6.0, 24.0, 20.0, 30.0, 63.0, 56.0, 72.0]);
        let diagonal: Vec<f32> = products(&block, 3, (1, -1)).collect();
        assert_eq!(diagonal[0], 1.0 * 8.0);
        assert_eq!(diagonal[8], 9.0 * 4.0);
    }
}
