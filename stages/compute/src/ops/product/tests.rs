//! Products against sums in `f64` and their own adjoints, and on a GPU.

use std::sync::Arc;

use proptest::prelude::*;

use super::cpu::cut::cut;
use super::cpu::product::add_product;
use super::cpu::tile::Old;
use super::linear::{linear, linear_backward_input, linear_backward_weight};
use super::matmul::matmul;
use crate::check::{
    agree, assert_adjoint, assert_close, assert_near, assert_rounded, assert_same_bits, bits, dot,
    normals, pattern, stored, to,
};
use crate::runtime::cpu::matrix::Matrix;
use crate::runtime::cpu::share::Cut;
use crate::{Format, Precision, Weight, elementwise, shape, testing};

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
}

#[test]
fn matmul_is_linear_with_the_weight_turned() {
    let a = pattern(1, &[9, 31]);
    let b = pattern(2, &[31, 17]);
    let turned = shape::nchw_to_tokens(&b.reshape(&[1, 31, 17, 1])).reshape(&[17, 31]);
    assert_close("matmul", &matmul(&a, &b), &linear(&a, &turned, None), 1e-6);
}

#[test]
#[should_panic(expected = "linear: input [2, 3] and weight [5, 4]")]
fn a_wrong_shape_names_the_operator_and_the_shapes() {
    linear(&pattern(1, &[2, 3]), pattern(2, &[5, 4]), None);
}

#[test]
fn long_sums_round_little() {
    let x = normals("precision", 1, &[24, 2304]);
    let weight = normals("precision", 2, &[40, 2304]);
    let rows = x.to_vec();
    let columns = weight.to_vec();
    let y = linear(&x, &weight, None).to_vec();
    let mut off = 0.0;
    let mut size = 0.0;
    for (i, got) in y.into_iter().enumerate() {
        let pairs = rows[i / 40 * 2304..]
            .iter()
            .zip(&columns[i % 40 * 2304..])
            .take(2304);
        let exact: f64 = pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        (off, size) = (off + (f64::from(got) - exact).powi(2), size + exact.powi(2));
    }
    let error = (off / size).sqrt();
    assert!(
        error < 2.5e-7,
        "an error of {error}; one sum after the other has some 4e-7"
    );
}

#[test]
fn bf16_costs_two_or_three_digits() {
    for (rows, m, k) in [(5, 40, 33), (70, 130, 300), (3, 64, 1024)] {
        let weight = normals("precision", 1, &[m, k]);
        let x = normals("precision", 2, &[rows, k]);
        let dy = normals("precision", 3, &[rows, m]);
        let narrow = Weight::from(&weight).with_precision(Precision::Bf16);
        assert_rounded(
            "linear",
            &linear(&x, &narrow, None),
            &linear(&x, &weight, None),
        );
        assert_rounded(
            "input",
            &linear_backward_input(&dy, &narrow),
            &linear_backward_input(&dy, &weight),
        );
    }
}

#[test]
fn bf16_is_exact_where_the_factors_are() {
    let integers = |salt, shape: &[usize]| elementwise::sign(&pattern(salt, shape));
    let x = integers(1, &[17, 301]);
    let weight = integers(2, &[45, 301]);
    let narrow = Weight::from(&weight).with_precision(Precision::Bf16);
    assert_eq!(
        linear(&x, narrow, None).to_vec(),
        linear(&x, weight, None).to_vec()
    );
}

#[test]
fn a_weight_in_16_bits_acts_as_what_it_widens_to() {
    for format in [Format::F32, Format::F16, Format::Bf16] {
        for (rows, m, k) in [(1, 5, 3), (70, 130, 300), (40, 7, 600)] {
            let weight = stored(format, &[m, k]);
            let x = pattern(2, &[rows, k]);
            let dy = pattern(3, &[rows, m]);
            let wide = weight.to_array();
            assert_eq!(
                bits(&linear(&x, &weight, None)),
                bits(&linear(&x, &wide, None)),
                "{format:?}"
            );
            let [narrow, wide] = [
                linear_backward_input(&dy, &weight),
                linear_backward_input(&dy, &wide),
            ];
            assert_eq!(bits(&narrow), bits(&wide), "{format:?}");
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
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
        assert_same_bits(&format!("matmul {m} {k} {n}"), || vec![matmul(&a, &b)]);
        let bias = pattern(4, &[n]);
        let dy = pattern(5, &[m, n]);
        assert_same_bits(&format!("linear {m} {k} {n}"), || {
            vec![
                linear(&a, &w, Some(&bias)),
                linear_backward_input(&dy, &w),
                linear_backward_weight(&a, &dy),
            ]
        });
    }
}

/// A wide, low cut and a narrow, high one sum alike.
#[test]
fn the_cut_changes_no_bits() {
    let extents = [1, 1000, 500];
    let a = pattern(1, &[1000, 700]).to_vec();
    let b = pattern(2, &[700, 500]).to_vec();
    let [left, right] = [Matrix::new(&a, 1000, 700), Matrix::new(&b, 700, 500)];
    let products = [0, 1, 2, 1000].map(|packing| {
        let mut out = vec![0.0; 1000 * 500];
        let cut = cut(extents, packing);
        cut.for_each_share(&mut out, |mut share| {
            let how = (Old::Forget, Precision::F32);
            add_product(&mut share, &left, &right, 700, how);
        });
        (cut.share_panels, out)
    });
    for (panels, product) in &products[1..] {
        assert!(*product == products[0].1, "{panels} panels");
    }
    assert!(products[0].0 > products[3].0, "the cuts differ");
}

#[test]
fn a_cut_leaves_enough_tasks_and_reads_little() {
    let tasks = |cut: &Cut| cut.shares_across() * cut.shares_down();
    // Few columns and a deep sum: the left factor is read four times and not eight.
    let deep = cut([1, 1024, 512], 1);
    assert_eq!((deep.shares_across(), tasks(&deep)), (4, 16));
    // Dear columns are packed for all rows at once.
    assert_eq!(cut([1, 256, 1024], 4).shares_down(), 1);
    // Too little for that many tasks, or nothing at all.
    assert_eq!(tasks(&cut([1, 4, 512], 1)), 8);
    assert_eq!(tasks(&cut([1, 0, 512], 1)), 0);
}

/// What a GPU gives beside the CPU. Skipped where there is no adapter.
mod on_a_gpu {
    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 21))]

        #[test]
        fn linear_layers(rows in 1usize..150, k in 1usize..150, m in 1usize..150, bias: bool) {
            let inputs = [
                pattern(1, &[rows, k]),
                pattern(2, &[m, k]),
                pattern(3, &[m]),
                pattern(4, &[rows, m]),
            ];
            agree("linear", &inputs, |x| vec![
                linear(&x[0], &x[1], bias.then_some(&x[2])),
                linear_backward_input(&x[3], &x[1]),
                linear_backward_weight(&x[0], &x[3]),
                matmul(&x[3], &x[1]),
            ]);
        }
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
            let on = |device| {
                Weight::from_bytes(device, &[33, 21], format, Arc::new(bytes.clone()), 0..len)
            };
            let there = on(gpu);
            let here = on(&crate::Device::cpu());
            let x = pattern(1, &[40, 21]);
            assert_near(
                "linear",
                &linear(&to(gpu, &x), &there, None),
                &linear(&x, &here, None),
            );
            assert_eq!(
                shape::gather_rows(&there, &[3, 32]).to_vec(),
                shape::gather_rows(&here, &[3, 32]).to_vec()
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
}
