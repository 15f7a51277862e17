//! Normalisations against PyTorch and their own differences, and on a GPU.

use proptest::prelude::*;

use super::*;
use crate::check::{agree, assert_gradient, assert_same_bits, check_golden, pattern};
use crate::elementwise::scaled_sum;

#[test]
fn norms_are_torchs() {
    let x = pattern(5, &[2, 6, 5, 3]);
    let gamma = pattern(6, &[6]);
    let beta = pattern(7, &[6]);
    let dy = pattern(8, x.shape());
    for (name, act) in [("plain", Activation::None), ("silu", Activation::Silu)] {
        check_golden(
            &format!("group_norm.{name}"),
            &group_norm(&x, &gamma, &beta, 3, 1e-5, act),
        );
        let dx = group_norm_backward(&x, &gamma, &beta, 3, 1e-5, act, &dy);
        check_golden(&format!("group_norm.{name}.dx"), &dx);
    }
    let x = pattern(5, &[3, 37]);
    let gamma = pattern(6, &[37]);
    let beta = pattern(7, &[37]);
    check_golden("layer_norm", &layer_norm(&x, &gamma, &beta, 1e-5));
    check_golden(
        "layer_norm.dx",
        &layer_norm_backward(&x, &gamma, 1e-5, &pattern(8, x.shape())),
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
fn any_number_of_threads_gives_the_same_bits() {
    let gamma = pattern(2, &[12]);
    let beta = pattern(3, &[12]);
    let x = pattern(1, &[2, 12, 65, 63]);
    let dy = pattern(4, &[2, 12, 65, 63]);
    let tokens = x.reshape(&[65 * 63 * 2, 12]);
    let dtokens = dy.reshape(&[65 * 63 * 2, 12]);
    assert_same_bits("norms", || {
        vec![
            group_norm(&x, &gamma, &beta, 3, 1e-5, Activation::Silu),
            group_norm_backward(&x, &gamma, &beta, 3, 1e-5, Activation::Silu, &dy),
            layer_norm(&tokens, &gamma, &beta, 1e-5),
            layer_norm_backward(&tokens, &gamma, 1e-5, &dtokens),
        ]
    });
}

/// What a GPU gives beside the CPU. Skipped where there is no adapter.
mod on_a_gpu {
    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 21))]

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
            let weights = |c| [pattern(2, &[c]), pattern(3, &[c])];
            let [gamma, beta] = weights(c);
            agree("group_norm", &[pattern(1, &shape), gamma, beta, pattern(4, &shape)], |x| vec![
                group_norm(&x[0], &x[1], &x[2], groups, 1e-3, activation),
                group_norm_backward(&x[0], &x[1], &x[2], groups, 1e-3, activation, &x[3]),
            ]);
            let shape = [rows, width];
            let [gamma, beta] = weights(width);
            agree("layer_norm", &[pattern(1, &shape), gamma, beta, pattern(4, &shape)], |x| vec![
                layer_norm(&x[0], &x[1], &x[2], 1e-3),
                layer_norm_backward(&x[0], &x[1], 1e-3, &x[3]),
            ]);
        }
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
}
