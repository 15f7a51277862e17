//! What bf16 products cost.

use compute::conv::{Conv, conv2d, conv2d_backward_input};
use compute::linear::{linear, linear_backward_input};
use compute::{Array, Device, Precision, Rng, Weight, elementwise};

use crate::common::{dot, pattern};

/// Independent normal numbers: patterns would add up, and hide the error of rounding.
fn normals(salt: u64, shape: &[usize]) -> Array {
    Rng::new(salt, "precision").normals(0, shape, &Device::cpu())
}

/// The norm of the difference over the norm.
fn error(got: &Array, exact: &Array) -> f64 {
    let difference = elementwise::sub(got, exact);
    (dot(&difference, &difference) / dot(exact, exact)).sqrt()
}

#[test]
fn long_sums_round_little() {
    let x = normals(1, &[24, 2304]);
    let weight = normals(2, &[40, 2304]);
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

/// Rounding both factors to 8 bits costs each product 2^-9 times sqrt(2/3) of its size, root mean
/// square; sums of many keep that ratio. The bounds leave a factor of two, and demand that
/// something was rounded.
#[track_caller]
fn assert_rounded(what: &str, got: &Array, exact: &Array) {
    let error = error(got, exact);
    assert!(1e-4 < error && error < 4e-3, "{what}: an error of {error}");
}

#[test]
fn bf16_costs_two_or_three_digits() {
    for (rows, m, k) in [(5, 40, 33), (70, 130, 300), (3, 64, 1024)] {
        let weight = normals(1, &[m, k]);
        let x = normals(2, &[rows, k]);
        let dy = normals(3, &[rows, m]);
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
    for (c, o, kernel, stride) in [(12, 20, 3, 1), (12, 20, 3, 2), (70, 33, 1, 1)] {
        let weight = normals(1, &[o, c, kernel, kernel]);
        let x = normals(2, &[2, c, 13, 13]);
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
