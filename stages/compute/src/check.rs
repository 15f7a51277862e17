//! What the tests of operators share: arrays made by formula, and comparisons that say where they
//! fail.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use crate::{Array, Device, Format, Rng, Weight, elementwise, testing};

/// Numbers in [-1, 1) that look random and are exact in f32; `tests/golden/generate.py` has the
/// same formula.
pub fn pattern(salt: u64, shape: &[usize]) -> Array {
    let len: usize = shape.iter().product();
    let value = |i: u64| {
        ((i + salt * 7919).wrapping_mul(2_654_435_761) as u32 >> 16) as f32 / 32768.0 - 1.0
    };
    Device::cpu().array(shape, (0..len as u64).map(value).collect())
}

/// The inner product of all elements, summed in f64 and in their order.
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
            &f(&elementwise::scaled_sum(&[(1.0, x), (t, &direction)])),
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

/// Independent normal numbers: patterns would add up, and hide the error of rounding.
pub fn normals(domain: &str, salt: u64, shape: &[usize]) -> Array {
    Rng::new(salt, domain).normals(0, shape, &Device::cpu())
}

/// The bits of all values.
pub fn bits(array: &Array) -> Vec<u32> {
    array.to_vec().iter().map(|value| value.to_bits()).collect()
}

/// Fails unless `work` gives the same bits in pools of 1, 2 and 7 threads.
#[track_caller]
pub fn assert_same_bits(what: &str, work: impl Fn() -> Vec<Array> + Sync) {
    let run = |threads: usize| -> Vec<Vec<u32>> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool of threads");
        let arrays = pool.install(&work);
        arrays.iter().map(bits).collect()
    };
    let one = run(1);
    assert!(one == run(2), "{what}: 2 threads differ from 1");
    assert!(one == run(7), "{what}: 7 threads differ from 1");
}

/// What PyTorch and Pillow answer, written by `tests/golden/generate.py`.
static GOLDEN: LazyLock<BTreeMap<String, serde_json::Value>> = LazyLock::new(|| {
    let text = include_str!("../tests/golden/golden.json");
    serde_json::from_str(text).expect("golden.json parses")
});

fn golden(name: &str) -> Array {
    let list = |key: &str| GOLDEN[name][key].as_array().expect("a list");
    let extents = list("shape").iter().map(|extent| extent.as_u64());
    let shape: Option<Vec<usize>> = extents.map(|extent| Some(extent? as usize)).collect();
    let values = list("values").iter().map(|value| value.as_f64());
    let values: Option<Vec<f32>> = values.map(|value| Some(value? as f32)).collect();
    Device::cpu().array(&shape.expect("extents"), values.expect("numbers"))
}

/// Fails unless `got` is the golden array of that name, to 3e-6.
#[track_caller]
pub fn check_golden(name: &str, got: &Array) {
    assert_close(name, got, &golden(name), 3e-6);
}

/// Fails unless `got` is the golden resized image of that name, to 1e-5. PyTorch rounds the
/// position of a resampled pixel to f32, which costs it a digit; ours is f64.
#[track_caller]
pub fn check_resized(name: &str, got: &Array) {
    assert_close(name, got, &golden(&format!("resize.{name}")), 1e-5);
}

/// The first adapter, opened once for all tests, if there is one.
pub fn gpu() -> Option<&'static Device> {
    static GPU: LazyLock<Option<Device>> = LazyLock::new(testing::gpu);
    GPU.as_ref()
}

/// A copy on another device.
pub fn to(device: &Device, x: &Array) -> Array {
    device.array(x.shape(), x.to_vec())
}

/// Computes on both devices, from copies of the same inputs, and fails unless they agree as
/// [`assert_near`] has it.
#[track_caller]
pub fn agree(what: &str, inputs: &[Array], compute: impl Fn(&[Array]) -> Vec<Array>) {
    let Some(gpu) = gpu() else { return };
    let copies: Vec<Array> = inputs.iter().map(|input| to(gpu, input)).collect();
    let expected = compute(inputs);
    let got = compute(&copies);
    for (which, (expected, got)) in expected.iter().zip(&got).enumerate() {
        assert!(got.device().is_gpu(), "{what}: result {which} left the GPU");
        assert_near(&format!("{what}, result {which}"), got, expected);
    }
}

/// What is smaller than this is what is left of numbers of about 1 that cancel, and the rounding is
/// theirs: the softmax of two keys, the norm of two numbers.
const CANCELLED: f32 = 1.0 / 32.0;

/// Fails unless every element agrees to 1e-5 of the largest magnitude.
#[track_caller]
pub fn assert_near(what: &str, got: &Array, expected: &Array) {
    assert_eq!(got.shape(), expected.shape(), "{what}: shapes");
    let expected = expected.to_vec();
    let got = got.to_vec();
    let size = expected.iter().fold(CANCELLED, |max, x| max.max(x.abs()));
    for (i, (got, expected)) in got.iter().zip(&expected).enumerate() {
        let error = (got - expected).abs() / size;
        assert!(
            error <= 1e-5,
            "{what}: element {i} is {got}, expected {expected}: {error:.1e}"
        );
    }
}

/// A pattern stored in `format`, three bytes into foreign bytes so that it lies at an odd address.
pub fn stored(format: Format, shape: &[usize]) -> Weight {
    let values = pattern(1, shape).to_vec();
    let encoded = values.iter().flat_map(|value| match format {
        Format::F32 => value.to_le_bytes().to_vec(),
        Format::F16 => half::f16::from_f32(*value).to_le_bytes().to_vec(),
        Format::Bf16 => half::bf16::from_f32(*value).to_le_bytes().to_vec(),
    });
    let bytes: Vec<u8> = [1, 2, 3].into_iter().chain(encoded).collect();
    let range = 3..bytes.len();
    Weight::from_bytes(&Device::cpu(), shape, format, Arc::new(bytes), range)
}

/// The norm of the difference over the norm.
fn error(got: &Array, exact: &Array) -> f64 {
    let difference = elementwise::sub(got, exact);
    (dot(&difference, &difference) / dot(exact, exact)).sqrt()
}

/// Rounding both factors to 8 bits costs each product 2^-9 times sqrt(2/3) of its size, root mean
/// square; sums of many keep that ratio. The bounds leave a factor of two, and demand that
/// something was rounded.
#[track_caller]
pub fn assert_rounded(what: &str, got: &Array, exact: &Array) {
    let error = error(got, exact);
    assert!(1e-4 < error && error < 4e-3, "{what}: an error of {error}");
}
