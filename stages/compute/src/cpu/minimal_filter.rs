//! Winograd's minimal filtering F(4x4, 3x3): the transforms of inputs, kernels and outputs, many tiles side by side.
//! Lavin and Gray 2015, section 4.3, with the points 0, ±3/4, ±3/2 and infinity, whose transforms B^T, G and A^T lose
//! half as many bits as theirs: some five times the rounding error of plain summation, about 2e-6 of the norm.
//!
//! It knows no images and no channels.

use super::simd::vectorize;
use super::tile::COLUMNS;

/// Outputs of a tile, each way.
pub const SIDE: usize = 4;
/// Inputs that a tile sees, each way.
pub const SIGHT: usize = 6;
/// Numbers of a transformed tile.
pub const SPOTS: usize = SIGHT * SIGHT;

/// The two positive points, A and B, and their powers.
const A: f32 = 0.75;
const B: f32 = 1.5;
const AA: f32 = A * A;
const BB: f32 = B * B;

/// Which way the kernels are used.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// `[O, C, 3, 3]` as they are.
    Forward,
    /// As the gradient to the input uses them: `[C, O]`, with the taps in reverse.
    Backward,
}

/// The four lines of `len` elements.
pub fn lines_of(lines: &mut [f32], len: usize) -> [&mut [f32]; SIDE] {
    let (ab, cd) = lines.split_at_mut(2 * len);
    let ((a, b), (c, d)) = (ab.split_at_mut(len), cd.split_at_mut(len));
    [a, b, c, d]
}

/// B^T of six numbers.
#[inline(always)]
fn input_transform(d: [f32; SIGHT]) -> [f32; SIGHT] {
    let (even_a, odd_a) = (d[4] - BB * d[2], A * (d[3] - BB * d[1]));
    let (even_b, odd_b) = (d[4] - AA * d[2], B * (d[3] - AA * d[1]));
    let ends = |x: f32, y: f32, z: f32| AA * BB * x - (AA + BB) * y + z;
    [
        ends(d[0], d[2], d[4]),
        even_a + odd_a,
        even_a - odd_a,
        even_b + odd_b,
        even_b - odd_b,
        ends(d[1], d[3], d[5]),
    ]
}

/// A^T of six numbers.
#[inline(always)]
fn output_transform(m: [f32; SIGHT]) -> [f32; SIDE] {
    let (sum_a, difference_a, sum_b, difference_b) =
        (m[1] + m[2], m[1] - m[2], m[3] + m[4], m[3] - m[4]);
    [
        m[0] + sum_a + sum_b,
        A * difference_a + B * difference_b,
        AA * sum_a + BB * sum_b,
        A * AA * difference_a + B * BB * difference_b + m[5],
    ]
}

/// B^T down the six lines, in place.
pub fn transform_down(lines: &mut [f32]) {
    let len = lines.len() / SIGHT;
    let (abc, def) = lines.split_at_mut(3 * len);
    let ((a, bc), (d, ef)) = (abc.split_at_mut(len), def.split_at_mut(len));
    let ((b, c), (e, f)) = (bc.split_at_mut(len), ef.split_at_mut(len));
    vectorize(
        #[inline(always)]
        || {
            for (((((a, b), c), d), e), f) in a.iter_mut().zip(b).zip(c).zip(d).zip(e).zip(f) {
                [*a, *b, *c, *d, *e, *f] = input_transform([*a, *b, *c, *d, *e, *f]);
            }
        },
    );
}

/// B^T along a line: `spots [SIGHT, len / SIDE]`, of which the last of each tile row means nothing.
pub fn transform_along(line: &[f32], spots: &mut [f32]) {
    let (quads, _) = line.as_chunks::<SIDE>();
    let len = quads.len();
    let (abc, def) = spots.split_at_mut(3 * len);
    let ((a, bc), (d, ef)) = (abc.split_at_mut(len), def.split_at_mut(len));
    let ((b, c), (e, f)) = (bc.split_at_mut(len), ef.split_at_mut(len));
    vectorize(
        #[inline(always)]
        || {
            let outputs = a.iter_mut().zip(b).zip(c).zip(d).zip(e).zip(f);
            for ((((((a, b), c), d), e), f), (x, y)) in outputs.zip(quads.iter().zip(&quads[1..])) {
                [*a, *b, *c, *d, *e, *f] = input_transform([x[0], x[1], x[2], x[3], y[0], y[1]]);
            }
        },
    );
}

/// Tiles whose outputs are computed side by side.
pub const LANES: usize = 16;

/// A^T from both sides of [`LANES`] tiles, plus `bias`, written as four lines of pixels.
#[inline(always)]
pub fn untransform(spots: [&[f32]; SPOTS], bias: f32, lines: [&mut [f32]; SIDE]) {
    let mut down = [[[0.0; LANES]; SIGHT]; SIDE];
    for column in 0..SIGHT {
        for lane in 0..LANES {
            let values = output_transform(std::array::from_fn(|line| {
                spots[line * SIGHT + column][lane]
            }));
            for (down, value) in down.iter_mut().zip(values) {
                down[column][lane] = value;
            }
        }
    }
    for (line, down) in lines.into_iter().zip(&down) {
        for (lane, quad) in line
            .as_chunks_mut::<SIDE>()
            .0
            .iter_mut()
            .enumerate()
            .take(LANES)
        {
            *quad = output_transform(std::array::from_fn(|column| down[column][lane]))
                .map(|value| value + bias);
        }
    }
}

/// G of three numbers.
#[inline(always)]
fn kernel_transform([x, y, z]: [f32; 3]) -> [f32; SIGHT] {
    // The reciprocals of what the polynomial x (x^2 - A^2) (x^2 - B^2) slopes by at 0, A and B.
    const ZERO: f32 = 1.0 / (AA * BB);
    const AT_A: f32 = 1.0 / (2.0 * AA * (AA - BB));
    const AT_B: f32 = 1.0 / (2.0 * BB * (BB - AA));
    let (even_a, odd_a) = (AT_A * x + AT_A * AA * z, AT_A * A * y);
    let (even_b, odd_b) = (AT_B * x + AT_B * BB * z, AT_B * B * y);
    [
        ZERO * x,
        even_a + odd_a,
        even_a - odd_a,
        even_b + odd_b,
        even_b - odd_b,
        z,
    ]
}

/// G from both sides of [`COLUMNS`] kernels, whose taps are the rows of `taps`.
#[inline(always)]
pub fn transform_taps(
    taps: &[f32; 9 * COLUMNS],
    direction: Direction,
    spots: &mut [[f32; COLUMNS]; SPOTS],
) {
    for lane in 0..COLUMNS {
        let tap = |row: usize, column: usize| match direction {
            Direction::Forward => taps[(3 * row + column) * COLUMNS + lane],
            Direction::Backward => taps[(8 - 3 * row - column) * COLUMNS + lane],
        };
        let down: [[f32; SIGHT]; 3] = std::array::from_fn(|column| {
            kernel_transform(std::array::from_fn(|row| tap(row, column)))
        });
        for line in 0..SIGHT {
            let along = kernel_transform(std::array::from_fn(|column| down[column][line]));
            for (column, value) in along.into_iter().enumerate() {
                spots[line * SIGHT + column][lane] = value;
            }
        }
    }
}
