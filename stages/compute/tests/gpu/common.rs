//! The device under test, and comparisons.

use std::sync::LazyLock;

use compute::{Array, Device, testing};

/// The first adapter, opened once for all tests, if there is one.
pub fn gpu() -> Option<&'static Device> {
    static GPU: LazyLock<Option<Device>> = LazyLock::new(testing::gpu);
    GPU.as_ref()
}

/// Numbers in [-1, 1) that look random, on the CPU.
pub fn pattern(salt: u64, shape: &[usize]) -> Array {
    let len: usize = shape.iter().product();
    let value = |i: u64| {
        ((i + salt * 7919).wrapping_mul(2_654_435_761) as u32 >> 16) as f32 / 32768.0 - 1.0
    };
    Device::cpu().array(shape, (0..len as u64).map(value).collect())
}

/// A copy on another device.
pub fn to(device: &Device, x: &Array) -> Array {
    device.array(x.shape(), x.to_vec())
}

/// Computes on both devices, from copies of the same inputs, and fails unless they agree as
/// [`assert_close`] has it.
#[track_caller]
pub fn agree(what: &str, inputs: &[Array], compute: impl Fn(&[Array]) -> Vec<Array>) {
    let Some(gpu) = gpu() else { return };
    let copies: Vec<Array> = inputs.iter().map(|input| to(gpu, input)).collect();
    let expected = compute(inputs);
    let got = compute(&copies);
    for (which, (expected, got)) in expected.iter().zip(&got).enumerate() {
        assert!(got.device().is_gpu(), "{what}: result {which} left the GPU");
        assert_close(&format!("{what}, result {which}"), got, expected);
    }
}

/// What is smaller than this is what is left of numbers of about 1 that cancel, and the rounding is
/// theirs: the softmax of two keys, the norm of two numbers.
const CANCELLED: f32 = 1.0 / 32.0;

/// Fails unless every element agrees to 1e-5 of the largest magnitude.
#[track_caller]
pub fn assert_close(what: &str, got: &Array, expected: &Array) {
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
