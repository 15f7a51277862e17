//! What the tests of this crate share: arrays made by formula, and comparisons that say where they
//! fail.
#![allow(dead_code, reason = "each test program uses its own part")]

use compute::{Array, Device};

/// Numbers in [-1, 1) that look random and are exact in f32; `golden/generate.py` has the same
/// formula.
pub fn pattern(salt: u64, shape: &[usize]) -> Array {
    let len: usize = shape.iter().product();
    let value = |i: u64| {
        ((i + salt * 7919).wrapping_mul(2_654_435_761) as u32 >> 16) as f32 / 32768.0 - 1.0
    };
    Device::cpu().array(shape, (0..len as u64).map(value).collect())
}

/// The inner product.
pub fn dot(x: &Array, y: &Array) -> f64 {
    assert_eq!(x.shape(), y.shape());
    x.to_vec()
        .iter()
        .zip(y.to_vec())
        .map(|(&x, y)| f64::from(x) * f64::from(y))
        .sum()
}

/// Fails unless every element agrees to `tolerance`, relative to the largest expected magnitude.
#[track_caller]
pub fn assert_close(what: &str, got: &Array, expected: &Array, tolerance: f32) {
    assert_eq!(got.shape(), expected.shape(), "{what}: shapes");
    let got = got.to_vec();
    let expected = expected.to_vec();
    let size = expected.iter().fold(1e-30f32, |max, x| max.max(x.abs()));
    for (i, (got, expected)) in got.iter().zip(&expected).enumerate() {
        let error = (got - expected).abs() / size;
        assert!(
            error <= tolerance,
            "{what}: element {i} is {got}, expected {expected}"
        );
    }
}

/// Fails unless `back`, which is `<x, A^T dy>`, is `<y, dy>` with y = A x. Relative to the norms:
/// the products may cancel.
#[track_caller]
pub fn assert_adjoint(what: &str, y: &Array, dy: &Array, back: f64) {
    let forward = dot(y, dy);
    let scale = (dot(y, y) * dot(dy, dy)).sqrt();
    assert!(
        (forward - back).abs() <= 1e-5 * scale,
        "{what}: {forward} and {back}, norms {scale}"
    );
}

/// Fails unless `gradient` is the derivative of `<f(x), dy>` at `x`, by central differences along a
/// fixed direction.
#[track_caller]
pub fn assert_gradient(
    what: &str,
    x: &Array,
    dy: &Array,
    gradient: &Array,
    f: impl Fn(&Array) -> Array,
) {
    let direction = pattern(901, x.shape());
    let step = 1.0 / 256.0;
    let at = |t: f32| {
        dot(
            &f(&compute::elementwise::scaled_sum(&[
                (1.0, x),
                (t, &direction),
            ])),
            dy,
        )
    };
    let numeric = (at(step) - at(-step)) / f64::from(2.0 * step);
    let size =
        (dot(gradient, gradient) * dot(&direction, &direction)).sqrt() / (x.len() as f64).sqrt();
    let analytic = dot(gradient, &direction);
    assert!(
        (numeric - analytic).abs() <= 5e-3 * size,
        "{what}: numeric {numeric}, analytic {analytic}, scale {size}"
    );
}
