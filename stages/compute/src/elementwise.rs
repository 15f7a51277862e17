//! Arithmetic on arrays of equal shape. It knows no axes, but for the per-channel bias of images.

use crate::array::{Array, matrix, nchw, same_shape};
use crate::cpu;
use crate::device::Backend;

/// `x + y`.
pub fn add(x: &Array, y: &Array) -> Array {
    scaled_sum(&[(1.0, x), (1.0, y)])
}

/// `x - y`.
pub fn sub(x: &Array, y: &Array) -> Array {
    scaled_sum(&[(1.0, x), (-1.0, y)])
}

/// The product, element by element.
pub fn mul(x: &Array, y: &Array) -> Array {
    same_shape("mul", x, y);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(x.shape(), cpu::map::zip(x.host(), y.host(), |x, y| x * y)),
    }
}

/// `factor * x`.
pub fn scale(x: &Array, factor: f32) -> Array {
    scaled_sum(&[(factor, x)])
}

/// `a x + b y + ..` for terms `(a, x), (b, y), ..`, summed from left to right.
pub fn scaled_sum(terms: &[(f32, &Array)]) -> Array {
    let [(_, first), rest @ ..] = terms else { panic!("scaled_sum: no terms") };
    rest.iter().for_each(|(_, term)| same_shape("scaled_sum", first, term));
    match first.device().backend() {
        Backend::Cpu => {
            let terms: Vec<_> = terms.iter().map(|&(factor, term)| (factor, term.host())).collect();
            Array::on_cpu(first.shape(), cpu::map::scaled_sum(&terms))
        }
    }
}

/// `x [N, C, H, W]` with `bias [N, C]` added to every pixel.
pub fn add_channels(x: &Array, bias: &Array) -> Array {
    let ([n, c, h, w], per_image) = (nchw("add_channels", x), matrix("add_channels", bias));
    assert_eq!([n, c], per_image, "add_channels: input {:?}, bias {:?}", x.shape(), bias.shape());
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(x.shape(), cpu::map::add_per_plane(x.host(), bias.host(), h * w)),
    }
}

/// Every element moved into `low..=high`; NaN stays NaN.
pub fn clamp(x: &Array, low: f32, high: f32) -> Array {
    assert!(low <= high, "clamp: nothing lies in {low}..={high}");
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(x.shape(), cpu::map::map(x.host(), |x| x.clamp(low, high))),
    }
}

/// -1, 0 or 1 by the sign of every element.
pub fn sign(x: &Array) -> Array {
    match x.device().backend() {
        Backend::Cpu => {
            Array::on_cpu(x.shape(), cpu::map::map(x.host(), |x| (x > 0.0) as i32 as f32 - (x < 0.0) as i32 as f32))
        }
    }
}
