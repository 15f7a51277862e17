//! How trunks make their planes smaller: the largest of neighbours, and a blur. Knows planes of
//! numbers, and nothing of networks.

use compute::Array;
use compute::shape::pad_reflect;

/// The largest value of each window of `side` by `side`, `stride` apart, of `x [1, C, H, W]`.
/// `up` says whether a window that hangs over the edge counts (PyTorch's `ceil_mode`).
pub fn largest(x: &Array, side: usize, stride: usize, up: bool) -> Array {
    let [height, width] = [x.shape()[2], x.shape()[3]];
    let count = |length: usize| {
        // No underflow: pictures below `LEAST_SIDE`, whose planes would be too small, are refused.
        let rest = length - side;
        1 + if up {
            // As stride <= side, the last window begins inside, which PyTorch wants of `ceil_mode`.
            rest.div_ceil(stride)
        } else {
            rest / stride
        }
    };
    let largest_at = |plane: &[f32], row: usize, column: usize| {
        let rows = row * stride..height.min(row * stride + side);
        let columns = column * stride..width.min(column * stride + side);
        let values = rows.flat_map(|row| &plane[row * width..][columns.clone()]);
        values.copied().fold(f32::NEG_INFINITY, f32::max)
    };
    smaller(x, [count(height), count(width)], largest_at)
}

/// Taps of the blur, over their sum.
const BLUR: [f32; 3] = [0.25, 0.5, 0.25];

/// Every second pixel of `x [1, C, H, W]` after a blur by 1, 2, 1 both ways, mirrored two pixels
/// beyond each edge.
pub fn blurred(x: &Array) -> Array {
    // Three taps need one pixel; `stlpips-pytorch` pads by two, and its weights were fitted so.
    let x = pad_reflect(x, [2; 4]);
    let [height, width] = [x.shape()[2], x.shape()[3]];
    let count = |length: usize| 1 + (length - BLUR.len()) / 2;
    let mean_at = |plane: &[f32], row: usize, column: usize| {
        let rows = BLUR.iter().zip(plane.chunks(width).skip(2 * row));
        let of_row = |(tap, values): (&f32, &[f32])| {
            let columns = BLUR.iter().zip(&values[2 * column..]);
            columns
                .map(|(other, value)| tap * other * value)
                .sum::<f32>()
        };
        rows.map(of_row).sum()
    };
    smaller(&x, [count(height), count(width)], mean_at)
}

/// Planes of `height` by `width`, each value by what lies at its row and column.
fn smaller(
    x: &Array,
    [height, width]: [usize; 2],
    at: impl Fn(&[f32], usize, usize) -> f32,
) -> Array {
    let plane = x.shape()[2] * x.shape()[3];
    let values = x.to_vec();
    let mut out = Vec::with_capacity(x.shape()[1] * height * width);
    for plane in values.chunks(plane) {
        for row in 0..height {
            out.extend((0..width).map(|column| at(plane, row, column)));
        }
    }
    x.device().array(&[1, x.shape()[1], height, width], out)
}
