//! The GPU that tests use, of this crate and of those that bring kernels of their own. It knows no operator.

use crate::Device;

/// The first adapter, opened anew, so that its counts are the caller's own. Without one the caller skips its test, which is said on
/// stderr; where tests must not do without (`SRNERF_REQUIRE_GPU` is set, as by `make test`), it panics.
pub fn gpu() -> Option<Device> {
    match Device::gpu(Some(0)) {
        Ok(device) => Some(device),
        Err(error) if std::env::var_os("SRNERF_REQUIRE_GPU").is_some() => panic!("{error}"),
        Err(error) => {
            eprintln!("skipped, there is no GPU to test: {error}");
            None
        }
    }
}
