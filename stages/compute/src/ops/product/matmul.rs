//! The plain matrix product. It knows two axes and nothing of layers.

use super::{cpu, gpu};
use crate::runtime::array::{Array, matrix};
use crate::runtime::device::Backend;

/// `a b` for `a [M, K]` and `b [K, N]`, giving `[M, N]`.
pub fn matmul(a: &Array, b: &Array) -> Array {
    let [m, k] = matrix("matmul", a);
    let [k2, n] = matrix("matmul", b);
    assert_eq!(k, k2, "matmul: {:?} times {:?}", a.shape(), b.shape());
    match a.device().backend() {
        Backend::Cpu => Array::on_cpu(&[m, n], cpu::linear::matmul(a.host(), b.host(), [m, k, n])),
        Backend::Gpu(gpu) => {
            let values = gpu::linear::matmul(gpu, a.device_buffer(), b.device_buffer(), [m, k, n]);
            Array::on_gpu(gpu, &[m, n], values)
        }
    }
}
