//! The GPU that tests use, of this crate and of those that bring kernels of their own, and the
//! failures that it may have. It knows no operator.

use crate::runtime::device::{Device, GpuError};

/// The first adapter, opened anew, so that its counts are the caller's own. Without one the caller
/// skips its test, which is said on stderr; where tests must not do without (`SRNERF_REQUIRE_GPU`
/// is set, as by `make test`), it panics.
pub fn gpu() -> Option<Device> {
    or_skip(Device::gpu(Some(0)))
}

/// The first adapter as a weak one, whose kernels see no more than `window` bytes of an array at
/// once and name no numbers of 16 bits.
pub fn weak_gpu(window: u64) -> Option<Device> {
    or_skip(Device::weak_gpu(Some(0), window))
}

/// Takes a GPU away, as the reset of its driver does.
pub fn lose(device: &Device) {
    device.gpu_context().lose();
}

/// Leaves a GPU so many bytes for arrays.
pub fn limit_memory(device: &Device, bytes: u64) {
    device.gpu_context().limit_memory(bytes);
}

fn or_skip(opened: Result<Device, GpuError>) -> Option<Device> {
    match opened {
        Ok(device) => Some(device),
        Err(error) if std::env::var_os("SRNERF_REQUIRE_GPU").is_some() => panic!("{error}"),
        Err(error) => {
            eprintln!("skipped, there is no GPU to test: {error}");
            None
        }
    }
}
