//! Attention against PyTorch and its own differences, and on a GPU.

use proptest::prelude::*;

use super::*;
use crate::check::{agree, assert_gradient, assert_same_bits, check_golden, pattern};
use crate::elementwise::scale;

#[test]
fn attention_is_torchs() {
    let q = scale(&pattern(9, &[2, 67, 6]), 4.0);
    for (name, keys, causal) in [
        ("full", 67, false),
        ("cross", 5, false),
        ("causal", 67, true),
    ] {
        let k = pattern(10, &[2, keys, 6]);
        let v = pattern(11, &[2, keys, 6]);
        let attended = attention(&q, &k, &v, 2, causal);
        check_golden(&format!("attention.{name}"), &attended.out);
        let dout = pattern(12, q.shape());
        let gradients = attention_backward(&q, &k, &v, &attended, 2, causal, &dout);
        for (input, gradient) in ["dq", "dk", "dv"].iter().zip(&gradients) {
            check_golden(&format!("attention.{name}.{input}"), gradient);
        }
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
        let attend = |q: &Array, k: &Array, v: &Array| attention(q, k, v, heads, causal);
        let attended = attend(&q, &k, &v);
        let [dq, dk, dv] = attention_backward(&q, &k, &v, &attended, heads, causal, &dout);
        assert_gradient("queries", &q, &dout, &dq, |q| attend(q, &k, &v).out);
        assert_gradient("keys", &k, &dout, &dk, |k| attend(&q, k, &v).out);
        assert_gradient("values", &v, &dout, &dv, |v| attend(&q, &k, v).out);
    }
}

#[test]
fn attention_survives_large_scores() {
    let q = scale(&pattern(1, &[1, 600, 8]), 1e3);
    let k = pattern(2, &[1, 600, 8]);
    let v = pattern(3, &[1, 600, 8]);
    let out = attention(&q, &k, &v, 2, false).out;
    assert!(
        out.to_vec().iter().all(|x| x.abs() <= 1.0),
        "a weighted mean leaves the range of the values"
    );
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    for (tokens, causal) in [(1300, false), (600, true)] {
        let [q, k, v, dout] = [1, 2, 3, 4].map(|salt| pattern(salt, &[1, tokens, 48]));
        assert_same_bits("attention", || {
            let attended = attention(&q, &k, &v, 3, causal);
            let [dq, dk, dv] = attention_backward(&q, &k, &v, &attended, 3, causal, &dout);
            vec![attended.out, attended.lse, dq, dk, dv]
        });
    }
}

/// What a GPU gives beside the CPU. Skipped where there is no adapter.
mod on_a_gpu {
    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 21))]

        #[test]
        fn attention_of_all_shapes(
            (n, heads, depth) in (1usize..3, 1usize..4, 1usize..40),
            // With one key there is nothing to weigh: some gradients are zero but for rounding.
            (queries, keys) in (2usize..150, 2usize..150),
            causal: bool,
        ) {
            let keys = if causal { queries } else { keys };
            let shape = |tokens| [n, tokens, heads * depth];
            let of = |salt, tokens| pattern(salt, &shape(tokens));
            let inputs = [of(1, queries), of(2, keys), of(3, keys), of(4, queries)];
            check_attention(&inputs, heads, causal);
        }
    }

    fn check_attention(inputs: &[Array; 4], heads: usize, causal: bool) {
        agree("attention", inputs, |x| {
            let attended = attention(&x[0], &x[1], &x[2], heads, causal);
            let gradients =
                attention_backward(&x[0], &x[1], &x[2], &attended, heads, causal, &x[3]);
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
}
