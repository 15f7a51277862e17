//! The device under test, and arrays for it.

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
