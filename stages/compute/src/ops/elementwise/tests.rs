//! Arithmetic, activations and reductions on examples, against PyTorch and their own differences,
//! and on a GPU.

use proptest::prelude::*;

use super::*;
use crate::check::{agree, assert_gradient, assert_same_bits, check_golden, gpu, pattern, to};
use crate::{Device, shape};

fn array(shape: &[usize], values: &[f32]) -> Array {
    Device::cpu().array(shape, values.to_vec())
}

#[test]
fn arithmetic() {
    let x = array(&[3], &[1., -2., 0.]);
    let y = array(&[3], &[4., 5., 6.]);
    assert_eq!(add(&x, &y).to_vec(), [5., 3., 6.]);
    assert_eq!(sub(&x, &y).to_vec(), [-3., -7., -6.]);
    assert_eq!(mul(&x, &y).to_vec(), [4., -10., 0.]);
    assert_eq!(offset(&x, 0.5).to_vec(), [1.5, -1.5, 0.5]);
    assert_eq!(scale(&x, 3.0).to_vec(), [3., -6., 0.]);
    assert_eq!(sign(&x).to_vec(), [1., -1., 0.]);
    assert_eq!(clamp(&y, 4.5, 5.5).to_vec(), [4.5, 5., 5.5]);
    let image = array(&[1, 2, 1, 2], &[1., 2., 3., 4.]);
    assert_eq!(
        add_channels(&image, &array(&[1, 2], &[10., 20.])).to_vec(),
        [11., 12., 23., 24.]
    );
}

#[test]
fn what_is_below_zero_is_weakened() {
    let x = array(&[1, 2, 1, 3], &[1., -2., 0., -4., 5., -6.]);
    assert_eq!(activation::relu(&x).to_vec(), [1., 0., 0., 0., 5., 0.]);
    assert_eq!(
        activation::leaky_relu(&x, 0.5).to_vec(),
        [1., -1., 0., -2., 5., -3.]
    );
    assert_eq!(
        activation::prelu(&x, &array(&[2], &[0.5, 2.])).to_vec(),
        [1., -1., 0., -8., 5., -12.]
    );
    assert_eq!(
        activation::sigmoid(&array(&[3], &[0., 100., -100.])).to_vec()[..2],
        [0.5, 1.]
    );
}

#[test]
fn reductions_are_exact_where_f32_sums_are_not() {
    let x = Device::cpu().full(&[1000, 1000], 0.1);
    assert_eq!(reduce::mean(&x), 0.1);
    assert_eq!(reduce::sum(&x), 100_000.0);
    let y = array(&[4], &[1., -3., 2., 0.]);
    assert_eq!((reduce::mean_square(&y), reduce::max_abs(&y)), (3.5, 3.0));
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
fn activations_are_torchs() {
    let x = scale(&pattern(13, &[100]), 6.0);
    let dy = pattern(14, &[100]);
    type Forward = fn(&Array) -> Array;
    type Backward = fn(&Array, &Array) -> Array;
    let functions: [(&str, Forward, Backward); 3] = [
        ("silu", activation::silu, activation::silu_backward),
        ("gelu", activation::gelu, activation::gelu_backward),
        (
            "quick_gelu",
            activation::quick_gelu,
            activation::quick_gelu_backward,
        ),
    ];
    for (name, forward, backward) in functions {
        check_golden(name, &forward(&x));
        check_golden(&format!("{name}.dx"), &backward(&x, &dy));
    }
    let x = scale(&pattern(13, &[5, 22]), 3.0);
    check_golden("geglu", &activation::geglu(&x));
    check_golden(
        "geglu.dx",
        &activation::geglu_backward(&x, &pattern(14, &[5, 11])),
    );
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let x = pattern(1, &[2, 3, 130, 129]);
    let dy = pattern(2, &[2, 3, 130, 129]);
    assert_same_bits("reductions", || {
        let numbers = vec![
            reduce::sum(&x),
            reduce::mean(&x),
            reduce::mean_square(&x),
            reduce::max_abs(&x),
        ];
        vec![Device::cpu().array(&[4], numbers)]
    });
    let tokens = x.reshape(&[129 * 65, 12]);
    assert_same_bits("maps", || {
        vec![
            scaled_sum(&[(0.5, &x), (2.0, &dy), (-1.0, &x)]),
            activation::geglu(&tokens),
            activation::gelu_backward(&x, &dy),
        ]
    });
}

/// What a GPU gives beside the CPU. Skipped where there is no adapter.
mod on_a_gpu {
    use super::*;
    use crate::activation::{
        geglu, geglu_backward, gelu, gelu_backward, leaky_relu, quick_gelu, quick_gelu_backward,
        relu, sigmoid, silu, silu_backward,
    };

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 21))]

        #[test]
        fn all_functions(rows in 1usize..60, half in 1usize..60) {
            let shape = [rows, 2 * half];
            let inputs = [pattern(1, &shape), pattern(2, &shape), pattern(3, &[rows, half])];
            agree("elementwise", &inputs, |x| {
                let wide = scale(&x[0], 6.0);
                let dy = &x[1];
                vec![
                    silu(&wide), silu_backward(&wide, dy), gelu(&wide), gelu_backward(&wide, dy),
                    quick_gelu(&wide), quick_gelu_backward(&wide, dy),
                    geglu(&wide), geglu_backward(&wide, &x[2]),
                    mul(&wide, dy), sub(&wide, dy), sign(&wide), clamp(&wide, -2.0, 3.0),
                    relu(&wide), leaky_relu(&wide, 0.2), sigmoid(&wide), offset(&wide, -0.5),
                    scaled_sum(&[(0.5, &wide), (-2.0, dy), (3.0, &wide)]),
                ]
            });
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 21))]

        #[test]
        fn channels((n, c, h, w) in (1usize..4, 1usize..40, 2usize..20, 2usize..40)) {
            agree("channels", &[pattern(1, &[n, c, h, w]), pattern(2, &[n, c])], |x| {
                let slopes = shape::slice(&x[1], 0, n - 1, 1).reshape(&[c]);
                vec![add_channels(&x[0], &x[1]), activation::prelu(&x[0], &slopes)]
            });
        }
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
}
