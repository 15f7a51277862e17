//! Every operator, forward and backward, on random shapes: odd ones, ones that do not fill a tile,
//! and ones of several.

use std::sync::Arc;

use compute::activation::{
    geglu, geglu_backward, gelu, gelu_backward, leaky_relu, prelu, quick_gelu, quick_gelu_backward,
    relu, sigmoid, silu, silu_backward,
};
use compute::adam::{Adam, AdamState, update};
use compute::attention::{attention, attention_backward};
use compute::conv::{
    Conv, Finish, conv2d, conv2d_backward_input, conv2d_backward_weight, conv2d_finished,
};
use compute::elementwise::{add_channels, clamp, mul, offset, scale, scaled_sum, sign, sub};
use compute::linear::{linear, linear_backward_input, linear_backward_weight};
use compute::matmul::matmul;
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm, layer_norm_backward};
use compute::resize::{Filter, resize, resize_backward};
use compute::shape::{
    concat, crop, gather_rows, nchw_to_tokens, pad_reflect, pixel_shuffle, pixel_unshuffle, slice,
    tokens_to_nchw, upsample_nearest, upsample_nearest_backward,
};
use compute::{Array, Format, Weight, reduce, testing};
use proptest::prelude::*;

use crate::common::{agree, assert_close, gpu, pattern, to};

const FILTERS: [Filter; 6] = [
    Filter::Nearest,
    Filter::Bilinear,
    Filter::BicubicTorch,
    Filter::BicubicPil,
    Filter::Lanczos3,
    Filter::Area,
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 21))]

    #[test]
    fn linear_layers(rows in 1usize..150, k in 1usize..150, m in 1usize..150, bias: bool) {
        let inputs = [pattern(1, &[rows, k]), pattern(2, &[m, k]), pattern(3, &[m]), pattern(4, &[rows, m])];
        agree("linear", &inputs, |x| vec![
            linear(&x[0], &x[1], bias.then_some(&x[2])),
            linear_backward_input(&x[3], &x[1]),
            linear_backward_weight(&x[0], &x[3]),
            matmul(&x[3], &x[1]),
        ]);
    }

    #[test]
    fn convolutions(
        (n, c, o) in (1usize..3, 1usize..20, 1usize..40),
        (h, w) in (3usize..24, 3usize..24),
        // Each is a kernel of its own, which takes a software driver long to compile.
        [kh, kw] in prop::sample::select(vec![[1, 1], [3, 3], [2, 3]]),
        stride in 1usize..4,
        pad in prop::array::uniform4(0usize..3),
        bias: bool,
    ) {
        let conv = Conv { stride, pad };
        let x = pattern(1, &[n, c, h, w]);
        let weight = pattern(2, &[o, c, kh, kw]);
        let dy = pattern(3, conv2d(&x, &weight, None, conv).shape());
        agree("conv2d", &[x, weight, pattern(4, &[o]), dy], |x| vec![
            conv2d(&x[0], &x[1], bias.then_some(&x[2]), conv),
            conv2d_backward_input(&x[3], &x[1], conv, [h, w]),
            conv2d_backward_weight(&x[0], &x[3], conv, [kh, kw]),
        ]);
    }

    #[test]
    fn finished_convolutions(
        // With 64 channels the depth of a small product is cut, and finished where its parts are
        // joined.
        c in prop::sample::select(vec![1usize, 7, 64]),
        (n, o) in (1usize..3, 1usize..40),
        (h, w) in (3usize..24, 3usize..24),
        bias: bool,
        slope in prop::sample::select(vec![0.0f32, 0.2]),
    ) {
        let x = pattern(1, &[n, c, h, w]);
        let weight = pattern(2, &[o, c, 3, 3]);
        agree("conv2d_finished", &[x, weight, pattern(3, &[o]), pattern(4, &[n, o, h, w])], |x| {
            let finished = |finish| {
                conv2d_finished(&x[0], &x[1], bias.then_some(&x[2]), Conv::padded(1), finish)
            };
            vec![finished(Finish::Leaky(slope)), finished(Finish::Add(&x[3]))]
        });
    }

    #[test]
    fn attention_of_all_shapes(
        (n, heads, depth) in (1usize..3, 1usize..4, 1usize..40),
        // With one key there is nothing to weigh: some gradients are zero but for rounding.
        (queries, keys) in (2usize..150, 2usize..150),
        causal: bool,
    ) {
        let keys = if causal { queries } else { keys };
        let shape = |tokens| [n, tokens, heads * depth];
        let inputs = [pattern(1, &shape(queries)), pattern(2, &shape(keys)), pattern(3, &shape(keys)), pattern(4, &shape(queries))];
        check_attention(&inputs, heads, causal);
    }

    #[test]
    fn norms(
        (n, groups, each) in (1usize..3, 1usize..5, 1usize..5),
        (h, w) in (1usize..40, 1usize..40),
        (rows, width) in (1usize..40, 1usize..400),
        silu: bool,
    ) {
        let activation = if silu { Activation::Silu } else { Activation::None };
        let c = groups * each;
        let shape = [n, groups * each, h, w];
        agree("group_norm", &[pattern(1, &shape), pattern(2, &[c]), pattern(3, &[c]), pattern(4, &shape)], |x| vec![
            group_norm(&x[0], &x[1], &x[2], groups, 1e-3, activation),
            group_norm_backward(&x[0], &x[1], &x[2], groups, 1e-3, activation, &x[3]),
        ]);
        let shape = [rows, width];
        agree("layer_norm", &[pattern(1, &shape), pattern(2, &[width]), pattern(3, &[width]), pattern(4, &shape)], |x| vec![
            layer_norm(&x[0], &x[1], &x[2], 1e-3),
            layer_norm_backward(&x[0], &x[1], 1e-3, &x[3]),
        ]);
    }

    #[test]
    fn resizes(
        (h, w, height, width) in (1usize..40, 1usize..40, 1usize..40, 1usize..40),
        antialias: bool,
        filter in prop::sample::select(FILTERS.to_vec()),
    ) {
        agree("resize", &[pattern(1, &[2, 3, h, w]), pattern(2, &[2, 3, height, width])], |x| vec![
            resize(&x[0], height, width, filter, antialias),
            resize_backward(&x[1], h, w, filter, antialias),
        ]);
    }

    #[test]
    fn elementwise(rows in 1usize..60, half in 1usize..60) {
        let shape = [rows, 2 * half];
        agree("elementwise", &[pattern(1, &shape), pattern(2, &shape), pattern(3, &[rows, half])], |x| {
            let wide = scale(&x[0], 6.0);
            let dy = &x[1];
            vec![
                silu(&wide), silu_backward(&wide, dy), gelu(&wide), gelu_backward(&wide, dy),
                quick_gelu(&wide), quick_gelu_backward(&wide, dy), geglu(&wide), geglu_backward(&wide, &x[2]),
                mul(&wide, dy), sub(&wide, dy), sign(&wide), clamp(&wide, -2.0, 3.0),
                relu(&wide), leaky_relu(&wide, 0.2), sigmoid(&wide), offset(&wide, -0.5),
                scaled_sum(&[(0.5, &wide), (-2.0, dy), (3.0, &wide)]),
            ]
        });
    }

    #[test]
    fn moves((n, c, h, w) in (1usize..4, 1usize..40, 2usize..20, 2usize..40), factor in 1usize..4) {
        let pad = [1, h - 1, w - 1, 0];
        agree("moves", &[pattern(1, &[n, c, h, w]), pattern(2, &[n, c, h * factor, w * factor]), pattern(3, &[n, c])], |x| {
            let tokens = nchw_to_tokens(&x[0]);
            vec![
                tokens_to_nchw(&tokens, h, w), tokens.clone(), concat(&[&x[0], &x[0], &x[0]], 1), concat(&[&x[0], &x[0]], 0),
                slice(&x[0], 1, c / 2, c - c / 2), crop(&x[0], 1, w / 2, h - 1, w - w / 2), pad_reflect(&x[0], pad),
                upsample_nearest(&x[0], factor), upsample_nearest_backward(&x[1], factor), add_channels(&x[0], &x[2]),
                gather_rows(tokens.reshape(&[n * h * w, c]), &[1, 0, (n * h * w - 1) as u32]),
                pixel_shuffle(&concat(&vec![&x[0]; factor * factor], 1), factor), pixel_unshuffle(&x[1], factor),
                prelu(&x[0], &slice(&x[2], 0, n - 1, 1).reshape(&[c])),
            ]
        });
    }
}

fn check_attention(inputs: &[Array; 4], heads: usize, causal: bool) {
    agree("attention", inputs, |x| {
        let attended = attention(&x[0], &x[1], &x[2], heads, causal);
        let gradients = attention_backward(&x[0], &x[1], &x[2], &attended, heads, causal, &x[3]);
        [attended.out, attended.lse]
            .into_iter()
            .chain(gradients)
            .collect()
    });
}

#[test]
fn a_deep_head_is_summed_in_slices() {
    let inputs = [1, 2, 3, 4].map(|salt| scale(&pattern(salt, &[1, 70, 300]), 0.3));
    check_attention(&inputs, 1, false);
}

#[test]
fn products_of_every_tile_and_of_a_cut_depth() {
    for [rows, k, m] in [
        [1030, 40, 1030],
        [300, 700, 4],
        [4, 700, 300],
        [65, 2100, 66],
    ] {
        let inputs = [
            pattern(1, &[rows, k]),
            pattern(2, &[m, k]),
            pattern(3, &[m]),
        ];
        agree("linear", &inputs, |x| {
            vec![linear(&x[0], &x[1], Some(&x[2]))]
        });
    }
    let conv = Conv::padded(1);
    let inputs = [
        pattern(1, &[2, 70, 9, 7]),
        pattern(2, &[3, 70, 3, 3]),
        pattern(3, &[3]),
    ];
    agree("conv2d", &inputs, |x| {
        vec![conv2d(&x[0], &x[1], Some(&x[2]), conv)]
    });
}

#[test]
fn a_group_of_many_chunks() {
    let shape = [1, 4, 130, 90];
    let x = scaled_sum(&[
        (1.0, &pattern(1, &shape)),
        (1.0, &pattern(1, &shape).device().full(&shape, 3.0)),
    ]);
    agree(
        "group_norm",
        &[x, pattern(2, &[4]), pattern(3, &[4]), pattern(4, &shape)],
        |x| {
            let gamma = &x[1];
            let beta = &x[2];
            vec![
                group_norm(&x[0], gamma, beta, 2, 1e-5, Activation::Silu),
                group_norm_backward(&x[0], gamma, beta, 2, 1e-5, Activation::Silu, &x[3]),
            ]
        },
    );
}

#[test]
fn weights_stay_in_16_bits_and_are_widened_by_the_kernel() {
    // A device of its own, since it counts.
    let Some(gpu) = &testing::gpu() else { return };
    let values = pattern(2, &[33, 21]).to_vec();
    let halves: Vec<u8> = values
        .iter()
        .flat_map(|&v| half::f16::from_f32(v).to_le_bytes())
        .collect();
    let brains: Vec<u8> = values
        .iter()
        .flat_map(|&v| half::bf16::from_f32(v).to_le_bytes())
        .collect();
    for (format, bytes) in [(Format::F16, halves), (Format::Bf16, brains)] {
        let before = gpu.counts().unwrap();
        let len = bytes.len();
        let on =
            |device| Weight::from_bytes(device, &[33, 21], format, Arc::new(bytes.clone()), 0..len);
        let there = on(gpu);
        let here = on(&compute::Device::cpu());
        let x = pattern(1, &[40, 21]);
        assert_close(
            "linear",
            &linear(&to(gpu, &x), &there, None),
            &linear(&x, &here, None),
        );
        assert_eq!(
            gather_rows(&there, &[3, 32]).to_vec(),
            gather_rows(&here, &[3, 32]).to_vec()
        );
        assert_eq!(there.to_array().to_vec(), here.to_array().to_vec());
        let uploaded = (gpu.counts().unwrap() - before).uploaded as usize;
        assert_eq!(
            uploaded,
            4 * 40 * 21 + len + 4 * 2 * 21 + 4 * 33 * 21,
            "{format:?}: input, weight, rows, widened"
        );
    }
}

#[test]
fn steps_of_adam() {
    let adam = Adam {
        weight_decay: 0.1,
        ..Adam::default()
    };
    agree(
        "adam",
        &[pattern(1, &[37, 19]), pattern(2, &[37, 19])],
        |x| {
            let mut parameter = x[0].clone();
            let mut state = AdamState::new(&x[0]);
            (1..4).for_each(|step| update(&adam, &mut parameter, &x[1], &mut state, step));
            vec![parameter, state.m, state.v]
        },
    );
}

#[test]
fn reductions() {
    let Some(gpu) = gpu() else { return };
    for len in [0, 1, 255, 4097, 70_000] {
        let x = pattern(5, &[len]);
        let y = to(gpu, &x);
        let close = |a: f32, b: f32| {
            (a - b).abs() <= 1e-5 * len.max(1) as f32 || (a.is_nan() && b.is_nan())
        };
        assert!(close(reduce::sum(&y), reduce::sum(&x)), "sum of {len}");
        assert!(
            close(reduce::mean_square(&y), reduce::mean_square(&x)),
            "mean square of {len}"
        );
        assert_eq!(reduce::max_abs(&y), reduce::max_abs(&x), "largest of {len}");
    }
}
