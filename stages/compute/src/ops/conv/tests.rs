//! Convolution against its definition, PyTorch and its own adjoints, and on a GPU.

use proptest::prelude::*;

use super::*;
use crate::check::{
    agree, assert_adjoint, assert_close, assert_rounded, assert_same_bits, bits, check_golden, dot,
    normals, pattern, stored,
};
use crate::{Format, Precision};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 4))]

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
        let dx = conv2d_backward_input(&dy, &weight, conv, [h, w]);
        let dw = conv2d_backward_weight(&x, &dy, conv, [kh, kw]);
        assert_adjoint("input", &y, &dy, dot(&x, &dx));
        assert_adjoint("weight", &y, &dy, dot(&weight, &dw));
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
        assert_close("conv2d", &conv2d(&x, &weight, Some(&bias), conv), &expected, 1e-5);
    }
}

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
fn convolutions_are_torchs() {
    let x = pattern(1, &[2, 3, 9, 7]);
    let w = pattern(2, &[4, 3, 3, 3]);
    let b = pattern(3, &[4]);
    for (name, stride, pad) in [
        ("plain", 1, [1; 4]),
        ("strided", 2, [0, 1, 0, 1]),
        ("uneven", 1, [0, 2, 1, 0]),
    ] {
        let conv = Conv { stride, pad };
        let y = conv2d(&x, &w, Some(&b), conv);
        let dy = pattern(4, y.shape());
        check_golden(&format!("conv.{name}"), &y);
        check_golden(
            &format!("conv.{name}.dx"),
            &conv2d_backward_input(&dy, &w, conv, [9, 7]),
        );
        check_golden(
            &format!("conv.{name}.dw"),
            &conv2d_backward_weight(&x, &dy, conv, [3, 3]),
        );
    }
}

#[test]
fn a_weight_in_16_bits_acts_as_what_it_widens_to() {
    for format in [Format::F32, Format::F16, Format::Bf16] {
        for (c, o, kernel, stride, size) in [
            (3, 5, 3, 1, 9),
            (40, 33, 3, 1, 24),
            (17, 20, 1, 1, 13),
            (9, 20, 3, 2, 21),
            (64, 50, 3, 1, 24),
        ] {
            let weight = stored(format, &[o, c, kernel, kernel]);
            let wide = weight.to_array();
            let conv = Conv {
                stride,
                pad: [kernel / 2; 4],
            };
            let x = pattern(2, &[2, c, size, size]);
            let y = conv2d(&x, &wide, None, conv);
            assert_eq!(
                bits(&conv2d(&x, &weight, None, conv)),
                bits(&y),
                "{format:?}"
            );
            let back = |weight: &Weight| conv2d_backward_input(&y, weight, conv, [size; 2]);
            assert_eq!(
                bits(&back(&weight)),
                bits(&back(&wide.into())),
                "{format:?}"
            );
        }
    }
}

#[test]
fn bf16_costs_two_or_three_digits() {
    for (c, o, kernel, stride) in [(12, 20, 3, 1), (12, 20, 3, 2), (70, 33, 1, 1)] {
        let weight = normals("precision", 1, &[o, c, kernel, kernel]);
        let x = normals("precision", 2, &[2, c, 13, 13]);
        let conv = Conv {
            stride,
            pad: [kernel / 2; 4],
        };
        let narrow = Weight::from(&weight).with_precision(Precision::Bf16);
        let y = conv2d(&x, &weight, None, conv);
        assert_rounded("conv2d", &conv2d(&x, &narrow, None, conv), &y);
        let [got, exact] =
            [narrow, weight.into()].map(|w| conv2d_backward_input(&y, w, conv, [13, 13]));
        assert_rounded("input of conv2d", &got, &exact);
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    for (c, stride, pad, kernel) in [
        (67, 1, [1; 4], 3),
        // Too few channels for the filtering, either way.
        (40, 1, [1; 4], 3),
        (67, 2, [0, 1, 0, 1], 3),
        (67, 1, [0; 4], 1),
    ] {
        let conv = Conv { stride, pad };
        let x = pattern(1, &[2, c, 33, 47]);
        let w = pattern(2, &[65, c, kernel, kernel]);
        let dy = pattern(3, conv2d(&x, &w, None, conv).shape());
        assert_same_bits("conv", || {
            vec![
                conv2d(&x, &w, None, conv),
                conv2d_backward_input(&dy, &w, conv, [33, 47]),
                conv2d_backward_weight(&x, &dy, conv, [kernel, kernel]),
                conv2d_finished(&x, &w, None, conv, Finish::Leaky(0.2)),
                conv2d_finished(&x, &w, None, conv, Finish::Add(&dy)),
            ]
        });
    }
}

/// What a GPU gives beside the CPU. Skipped where there is no adapter.
mod on_a_gpu {
    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 21))]

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
            // With 64 channels the depth of a small product is cut, and finished where its parts
            // are joined.
            c in prop::sample::select(vec![1usize, 7, 64]),
            (n, o) in (1usize..3, 1usize..40),
            (h, w) in (3usize..24, 3usize..24),
            bias: bool,
            slope in prop::sample::select(vec![0.0f32, 0.2]),
        ) {
            let x = pattern(1, &[n, c, h, w]);
            let weight = pattern(2, &[o, c, 3, 3]);
            let inputs = [x, weight, pattern(3, &[o]), pattern(4, &[n, o, h, w])];
            agree("conv2d_finished", &inputs, |x| {
                let finished = |finish| {
                    conv2d_finished(&x[0], &x[1], bias.then_some(&x[2]), Conv::padded(1), finish)
                };
                vec![finished(Finish::Leaky(slope)), finished(Finish::Add(&x[3]))]
            });
        }
    }

    #[test]
    fn few_outputs_of_a_cut_depth() {
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
}
