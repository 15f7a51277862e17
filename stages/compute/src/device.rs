//! Where arrays live and operators run. It knows which back ends exist, not what they compute.

use crate::array::Array;
use crate::cpu;

/// A place for arrays. Cheap to clone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Device {
    backend: Backend,
}

/// The back ends that operators dispatch on, by `match`, in one place per operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Backend {
    /// Host memory and rayon's current thread pool.
    Cpu,
}

impl Device {
    /// The processor this program runs on.
    pub fn cpu() -> Device {
        Device { backend: Backend::Cpu }
    }

    /// A short name of the kind of device: `"cpu"`.
    pub fn kind(&self) -> &'static str {
        match self.backend {
            Backend::Cpu => "cpu",
        }
    }

    /// The vector instructions that kernels use: `"portable"`, `"avx2"` or `"avx512"`.
    pub fn instructions(&self) -> &'static str {
        match self.backend {
            Backend::Cpu => cpu::simd::Level::current().name(),
        }
    }

    pub(crate) fn backend(&self) -> &Backend {
        &self.backend
    }

    /// Moves `values` (row-major) to this device. Panics if their number is not the product of `shape`.
    pub fn array(&self, shape: &[usize], values: Vec<f32>) -> Array {
        match self.backend {
            Backend::Cpu => Array::on_cpu(shape, values),
        }
    }

    /// An array of zeros.
    pub fn zeros(&self, shape: &[usize]) -> Array {
        self.full(shape, 0.0)
    }

    /// An array with every element equal to `value`.
    pub fn full(&self, shape: &[usize], value: f32) -> Array {
        self.array(shape, vec![value; shape.iter().product()])
    }
}
