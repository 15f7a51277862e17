//! Every gradient against the map it belongs to: `<A x, y> = <x, A^T y>` where the map is linear,
//! central differences where it is not.

use crate::common::{assert_adjoint, assert_gradient, dot, pattern};
use compute::conv::{Conv, conv2d, conv2d_backward_input, conv2d_backward_weight};
use compute::linear::{linear, linear_backward_input, linear_backward_weight};
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm, layer_norm_backward};
use compute::resize::{Filter, resize, resize_backward};
use compute::{Array, activation, attention, matmul, shape};
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 4))]

    #[test]
    fn linear_has_adjoints(rows in 1usize..40, k in 1usize..70, m in 1usize..70) {
        let x = pattern(1, &[rows, k]);
        let w = pattern(2, &[m, k]);
        let dy = pattern(3, &[rows, m]);
        let y = linear(&x, &w, None);
        assert_adjoint("input", &y, &dy, dot(&x, &linear_backward_input(&dy, &w)));
        assert_adjoint("weight", &y, &dy, dot(&w, &linear_backward_weight(&x, &dy)));
    }

    #[test]
    fn conv_has_adjoints(
        (n, c, o) in (1usize..3, 1usize..9, 1usize..9),
        (h, w) in (3usize..34, 3usize..34),
        (kh, kw, stride) in (1usize..4, 1usize..4, 1usize..4),
        pad in prop::array::uniform4(0usize..4),
    ) {
        let conv = Conv { stride, pad };
        let x = pattern(1, &[n, c, h, w]);
        let weight = pattern(2, &[o, c, kh, kw]);
        let y = conv2d(&x, &weight, None, conv);
        let dy = pattern(3, y.shape());
        assert_adjoint("input", &y, &dy, dot(&x, &conv2d_backward_input(&dy, &weight, conv, [h, w])));
        assert_adjoint("weight", &y, &dy, dot(&weight, &conv2d_backward_weight(&x, &dy, conv, [kh, kw])));
    }

    #[test]
    fn conv_is_its_definition(
        (c, o, h, w) in (1usize..6, 1usize..6, 3usize..12, 3usize..12),
        (kh, kw, stride) in (1usize..4, 1usize..4, 1usize..4),
        pad in prop::array::uniform4(0usize..4),
    ) {
        let conv = Conv { stride, pad };
        let x = pattern(1, &[1, c, h, w]);
        let weight = pattern(2, &[o, c, kh, kw]);
        let bias = pattern(3, &[o]);
        let expected = definition(&x, &weight, &bias, conv);
        crate::common::assert_close("conv2d", &conv2d(&x, &weight, Some(&bias), conv), &expected, 1e-5);
    }

    #[test]
    fn resize_has_an_adjoint(
        (h, w, height, width) in (1usize..40, 1usize..40, 1usize..40, 1usize..40),
        antialias: bool,
        filter in prop::sample::select(FILTERS.to_vec()),
    ) {
        let x = pattern(1, &[2, 1, h, w]);
        let dy = pattern(2, &[2, 1, height, width]);
        let y = resize(&x, height, width, filter, antialias);
        assert_adjoint("resize", &y, &dy, dot(&x, &resize_backward(&dy, h, w, filter, antialias)));
    }

    #[test]
    fn resize_keeps_a_constant(
        (h, w, height, width) in (1usize..40, 1usize..40, 1usize..40, 1usize..40),
        antialias: bool,
        filter in prop::sample::select(FILTERS.to_vec()),
    ) {
        let ones = compute::Device::cpu().full(&[1, 1, h, w], 1.0);
        let expected = compute::Device::cpu().full(&[1, 1, height, width], 1.0);
        crate::common::assert_close("resize", &resize(&ones, height, width, filter, antialias), &expected, 1e-6);
    }
}

const FILTERS: [Filter; 6] = [
    Filter::Nearest,
    Filter::Bilinear,
    Filter::BicubicTorch,
    Filter::BicubicPil,
    Filter::Lanczos3,
    Filter::Area,
];

/// Convolution as the textbook sums it.
fn definition(x: &Array, weight: &Array, bias: &Array, conv: Conv) -> Array {
    let (&[_, c, h, w], &[o, _, kh, kw]) = (x.shape(), weight.shape()) else {
        panic!("four axes")
    };
    let [top, bottom, left, right] = conv.pad;
    let height = (h + top + bottom - kh) / conv.stride + 1;
    let width = (w + left + right - kw) / conv.stride + 1;
    let values = x.to_vec();
    let kernel = weight.to_vec();
    let bias = bias.to_vec();
    let pixel = |c: usize, y: usize, x: usize| match (y.checked_sub(top), x.checked_sub(left)) {
        (Some(y), Some(x)) if y < h && x < w => values[(c * h + y) * w + x],
        _ => 0.0,
    };
    let mut out = Vec::new();
    for (o, y, x) in
        (0..o).flat_map(|o| (0..height).flat_map(move |y| (0..width).map(move |x| (o, y, x))))
    {
        let taps =
            (0..c).flat_map(|c| (0..kh).flat_map(move |ky| (0..kw).map(move |kx| (c, ky, kx))));
        let term = |(i, ky, kx)| {
            kernel[((o * c + i) * kh + ky) * kw + kx]
                * pixel(i, y * conv.stride + ky, x * conv.stride + kx)
        };
        out.push(bias[o] + taps.map(term).sum::<f32>());
    }
    x.device().array(&[1, o, height, width], out)
}

#[test]
fn a_convolution_of_many_tiles_has_adjoints() {
    let conv = Conv {
        stride: 1,
        pad: [1, 1, 1, 1],
    };
    let x = pattern(1, &[2, 70, 37, 31]);
    let weight = pattern(2, &[33, 70, 3, 3]);
    let y = conv2d(&x, &weight, None, conv);
    let dy = pattern(3, y.shape());
    assert_adjoint(
        "input",
        &y,
        &dy,
        dot(&x, &conv2d_backward_input(&dy, &weight, conv, [37, 31])),
    );
    assert_adjoint(
        "weight",
        &y,
        &dy,
        dot(&weight, &conv2d_backward_weight(&x, &dy, conv, [3, 3])),
    );
}

#[test]
fn norms_have_gradients() {
    let gamma = pattern(2, &[12]);
    let beta = pattern(3, &[12]);
    for (shape, groups) in [([2, 12, 5, 7], 4), ([1, 12, 1, 3], 1), ([3, 12, 9, 9], 12)] {
        let x = pattern(1, &shape);
        let dy = pattern(4, &shape);
        for act in [Activation::None, Activation::Silu] {
            let dx = group_norm_backward(&x, &gamma, &beta, groups, 1e-3, act, &dy);
            assert_gradient("group_norm", &x, &dy, &dx, |x| {
                group_norm(x, &gamma, &beta, groups, 1e-3, act)
            });
        }
    }
    for width in [1, 5, 64, 131] {
        let gamma = pattern(2, &[width]);
        let beta = pattern(3, &[width]);
        let x = pattern(1, &[21, width]);
        let dy = pattern(4, &[21, width]);
        let dx = layer_norm_backward(&x, &gamma, 1e-3, &dy);
        assert_gradient("layer_norm", &x, &dy, &dx, |x| {
            layer_norm(x, &gamma, &beta, 1e-3)
        });
    }
}

#[test]
fn attention_has_gradients() {
    // The last two span several tiles of keys and several ranges of the backward pass.
    for (queries, keys, heads, causal) in [
        (3, 3, 1, false),
        (67, 5, 3, false),
        (65, 65, 2, true),
        (97, 1300, 2, false),
        (1100, 1100, 1, true),
    ] {
        let q = pattern(1, &[2, queries, heads * 5]);
        let k = pattern(2, &[2, keys, heads * 5]);
        let v = pattern(3, &[2, keys, heads * 5]);
        let dout = pattern(4, q.shape());
        let attend = |q: &Array, k: &Array, v: &Array| attention::attention(q, k, v, heads, causal);
        let attended = attend(&q, &k, &v);
        let [dq, dk, dv] =
            attention::attention_backward(&q, &k, &v, &attended, heads, causal, &dout);
        assert_gradient("queries", &q, &dout, &dq, |q| attend(q, &k, &v).out);
        assert_gradient("keys", &k, &dout, &dk, |k| attend(&q, k, &v).out);
        assert_gradient("values", &v, &dout, &dv, |v| attend(&q, &k, v).out);
    }
}

#[test]
fn attention_survives_large_scores() {
    let q = compute::elementwise::scale(&pattern(1, &[1, 600, 8]), 1e3);
    let k = pattern(2, &[1, 600, 8]);
    let v = pattern(3, &[1, 600, 8]);
    let out = attention::attention(&q, &k, &v, 2, false).out;
    assert!(
        out.to_vec().iter().all(|x| x.abs() <= 1.0),
        "a weighted mean leaves the range of the values"
    );
}

#[test]
fn activations_have_gradients() {
    let x = pattern(1, &[7, 34]);
    let dy = pattern(2, &[7, 34]);
    assert_gradient(
        "silu",
        &x,
        &dy,
        &activation::silu_backward(&x, &dy),
        activation::silu,
    );
    assert_gradient(
        "gelu",
        &x,
        &dy,
        &activation::gelu_backward(&x, &dy),
        activation::gelu,
    );
    assert_gradient(
        "quick_gelu",
        &x,
        &dy,
        &activation::quick_gelu_backward(&x, &dy),
        activation::quick_gelu,
    );
    let dy = pattern(2, &[7, 17]);
    assert_gradient(
        "geglu",
        &x,
        &dy,
        &activation::geglu_backward(&x, &dy),
        activation::geglu,
    );
}

#[test]
fn upsampling_has_an_adjoint() {
    for factor in [1, 2, 3] {
        let x = pattern(1, &[2, 3, 5, 7]);
        let y = shape::upsample_nearest(&x, factor);
        let dy = pattern(2, y.shape());
        let back = shape::upsample_nearest_backward(&dy, factor);
        assert_adjoint("upsample_nearest", &y, &dy, dot(&x, &back));
    }
}

#[test]
fn matmul_is_linear_with_the_weight_turned() {
    let a = pattern(1, &[9, 31]);
    let b = pattern(2, &[31, 17]);
    let turned = shape::nchw_to_tokens(&b.reshape(&[1, 31, 17, 1])).reshape(&[17, 31]);
    crate::common::assert_close(
        "matmul",
        &matmul::matmul(&a, &b),
        &linear(&a, &turned, None),
        1e-6,
    );
}
