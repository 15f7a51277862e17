//! The same bits for any number of threads.

use crate::common::pattern;
use compute::adam::{Adam, AdamState, update};
use compute::conv::{
    Conv, Finish, conv2d, conv2d_backward_input, conv2d_backward_weight, conv2d_finished,
};
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm, layer_norm_backward};
use compute::resize::{Filter, resize};
use compute::{
    Array, Device, Rng, Weight, activation, attention, elementwise, linear, matmul, reduce, shape,
};

/// Fails unless `work` gives the same bits in pools of 1, 2 and 7 threads.
#[track_caller]
fn assert_same_bits(what: &str, work: impl Fn() -> Vec<Array> + Sync) {
    let run = |threads: usize| -> Vec<Vec<u32>> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool of threads");
        let arrays = pool.install(&work);
        arrays
            .iter()
            .map(|array| array.to_vec().iter().map(|x| x.to_bits()).collect())
            .collect()
    };
    let one = run(1);
    assert!(one == run(2), "{what}: 2 threads differ from 1");
    assert!(one == run(7), "{what}: 7 threads differ from 1");
}

#[test]
fn products() {
    for (m, k, n) in [
        (1, 700, 900),
        (900, 700, 1),
        (257, 2049, 131),
        (1024, 320, 512),
        (64, 64, 64),
        (4, 5000, 4),
    ] {
        let a = pattern(1, &[m, k]);
        let b = pattern(2, &[k, n]);
        let w = pattern(3, &[n, k]);
        assert_same_bits(&format!("matmul {m} {k} {n}"), || {
            vec![matmul::matmul(&a, &b)]
        });
        let bias = pattern(4, &[n]);
        let dy = pattern(5, &[m, n]);
        assert_same_bits(&format!("linear {m} {k} {n}"), || {
            vec![
                linear::linear(&a, &w, Some(&bias)),
                linear::linear_backward_input(&dy, &w),
                linear::linear_backward_weight(&a, &dy),
            ]
        });
    }
}

#[test]
fn convolutions() {
    for (stride, pad, kernel) in [(1, [1; 4], 3), (2, [0, 1, 0, 1], 3), (1, [0; 4], 1)] {
        let conv = Conv { stride, pad };
        let x = pattern(1, &[2, 67, 33, 47]);
        let w = pattern(2, &[65, 67, kernel, kernel]);
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

#[test]
fn filtered_convolutions() {
    // By bands of several images and of one; by outputs, for want of tiles and for their channels.
    for shape in [
        [2, 64, 47, 33],
        [1, 48, 256, 16],
        [4, 96, 8, 8],
        [1, 140, 40, 36],
    ] {
        let x = pattern(1, &shape);
        let w = pattern(2, &[70, shape[1], 3, 3]);
        let conv = Conv::padded(1);
        let dy = pattern(3, conv2d(&x, &w, None, conv).shape());
        assert_same_bits(&format!("conv {shape:?}"), || {
            let kept = Weight::from(&w).keeping_transforms();
            vec![
                conv2d(&x, &w, None, conv),
                conv2d_finished(&x, &kept, None, conv, Finish::Add(&dy)),
                conv2d_backward_input(&dy, &w, conv, [shape[2], shape[3]]),
            ]
        });
    }
}

#[test]
fn attentions() {
    for (tokens, causal) in [(1300, false), (600, true)] {
        let [q, k, v, dout] = [1, 2, 3, 4].map(|salt| pattern(salt, &[1, tokens, 48]));
        assert_same_bits("attention", || {
            let attended = attention::attention(&q, &k, &v, 3, causal);
            let [dq, dk, dv] =
                attention::attention_backward(&q, &k, &v, &attended, 3, causal, &dout);
            vec![attended.out, attended.lse, dq, dk, dv]
        });
    }
}

#[test]
fn norms_and_activations() {
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
            activation::geglu(&tokens),
            activation::gelu_backward(&x, &dy),
        ]
    });
}

#[test]
fn the_rest() {
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
    assert_same_bits("maps", || {
        let mut parameter = x.clone();
        let mut state = AdamState::new(&x);
        update(&Adam::default(), &mut parameter, &dy, &mut state, 1);
        vec![
            parameter,
            elementwise::scaled_sum(&[(0.5, &x), (2.0, &dy), (-1.0, &x)]),
            resize(&x, 47, 200, Filter::Lanczos3, true),
            shape::nchw_to_tokens(&x),
            Rng::new(3, "threads").normals(5, &[100_000], &Device::cpu()),
        ]
    });
}
