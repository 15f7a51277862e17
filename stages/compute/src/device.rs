//! Where arrays live and operators run. It knows which back ends exist, not what they compute.

use std::sync::Arc;

use crate::array::Array;
use crate::cpu;
use crate::gpu;
use crate::gpu::context::Gpu;
use crate::gpu::tuning::Tuning;

pub use crate::gpu::adapter::{HALVES, Report};
pub use crate::gpu::counts::Counts;
pub use crate::gpu::error::GpuError;
pub use crate::gpu::fault::attempt;

/// A place for arrays. Cheap to clone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Device {
    backend: Backend,
}

/// The back ends that operators dispatch on, by `match`, in one place per operator.
#[derive(Clone, Debug)]
pub(crate) enum Backend {
    /// Host memory and rayon's current thread pool.
    Cpu,
    /// The memory and the processors of one adapter.
    Gpu(Arc<Gpu>),
}

impl PartialEq for Backend {
    /// Arrays of two openings of one adapter cannot meet.
    fn eq(&self, other: &Backend) -> bool {
        match (self, other) {
            (Backend::Cpu, Backend::Cpu) => true,
            (Backend::Gpu(a), Backend::Gpu(b)) => Arc::ptr_eq(a, b),
            _ => false,
        }
    }
}

impl Eq for Backend {}

impl Device {
    /// The processor this program runs on.
    pub const fn cpu() -> Device {
        Device {
            backend: Backend::Cpu,
        }
    }

    /// Opens a GPU: the one that [`Device::adapters`] numbers `index`, or the first that is
    /// hardware. A fault of a GPU in use, such as full memory, unwinds to the nearest [`attempt`].
    pub fn gpu(index: Option<usize>) -> Result<Device, GpuError> {
        Ok(Device {
            backend: Backend::Gpu(Arc::new(Gpu::open(index, None)?)),
        })
    }

    /// The same, as if the adapter were a weak one ([`Gpu::open`]).
    pub(crate) fn weak_gpu(index: Option<usize>, window: u64) -> Result<Device, GpuError> {
        Ok(Device {
            backend: Backend::Gpu(Arc::new(Gpu::open(index, Some(window))?)),
        })
    }

    /// The first GPU that is hardware and can run our kernels, else the CPU. Where the system shows
    /// that there is no such hardware, no driver is asked.
    pub fn auto() -> Device {
        if gpu::adapter::hardware_is_likely() {
            Device::gpu(None).unwrap_or(Device::cpu())
        } else {
            Device::cpu()
        }
    }

    pub(crate) fn of(gpu: &Arc<Gpu>) -> Device {
        Device {
            backend: Backend::Gpu(gpu.clone()),
        }
    }

    /// The GPUs of this machine, hardware first; or why there are none.
    pub fn adapters() -> Result<Vec<Report>, GpuError> {
        Ok(gpu::adapter::find()?
            .into_iter()
            .map(|found| found.report)
            .collect())
    }

    /// What results depend on: `"cpu"`, or a GPU's name and driver.
    pub fn kind(&self) -> &str {
        match &self.backend {
            Backend::Cpu => "cpu",
            Backend::Gpu(gpu) => gpu.kind(),
        }
    }

    /// Whether this is a GPU of hardware.
    pub fn is_hardware(&self) -> bool {
        self.open_gpu().is_some_and(|gpu| gpu.is_hardware())
    }

    /// In which tiles a GPU computes matrix products, as text.
    pub fn tuning(&self) -> Option<String> {
        Some(self.open_gpu()?.tuning().to_string())
    }

    /// Takes the tiles that [`Device::tuning`] told of, on the same adapter. Whether the text was
    /// one.
    pub fn tune(&self, text: &str) -> bool {
        let found = self.open_gpu().zip(Tuning::read(text));
        found.inspect(|(gpu, tuning)| gpu.tune(*tuning)).is_some()
    }

    /// Tries which tiles are the fastest, in a second or so on hardware, and takes them. No result
    /// depends on it.
    pub fn measure(&self) -> Result<(), GpuError> {
        let Some(gpu) = self.open_gpu() else {
            return Ok(());
        };
        attempt(|| gpu.tune(Tuning::measure(gpu, 1)))
    }

    /// Whether this is a GPU, be it of software.
    pub fn is_gpu(&self) -> bool {
        matches!(self.backend, Backend::Gpu(_))
    }

    /// What a GPU was given to do since it was opened.
    pub fn counts(&self) -> Option<Counts> {
        match &self.backend {
            Backend::Cpu => None,
            Backend::Gpu(gpu) => Some(gpu.counts()),
        }
    }

    /// The open GPU, for kernels of one's own ([`crate::kernels`]).
    pub fn open_gpu(&self) -> Option<&Arc<Gpu>> {
        match &self.backend {
            Backend::Cpu => None,
            Backend::Gpu(gpu) => Some(gpu),
        }
    }

    /// Returns once all that was recorded is computed.
    pub fn finish(&self) {
        if let Backend::Gpu(gpu) = &self.backend {
            gpu.submit();
            gpu.wait();
        }
    }

    /// The vector instructions that kernels use: `"portable"`, `"avx2"` or `"avx512"`; `"wgsl"` on
    /// a GPU.
    pub fn instructions(&self) -> &'static str {
        match self.backend {
            Backend::Cpu => cpu::simd::Level::current().name(),
            Backend::Gpu(_) => "wgsl",
        }
    }

    pub(crate) fn backend(&self) -> &Backend {
        &self.backend
    }

    /// The open adapter; only arrays on a GPU ask.
    pub(crate) fn gpu_context(&self) -> &Gpu {
        match &self.backend {
            Backend::Gpu(gpu) => gpu,
            Backend::Cpu => panic!("the CPU has no device memory"),
        }
    }

    /// Moves `values` (row-major) to this device. Panics if their number is not the product of
    /// `shape`.
    pub fn array(&self, shape: &[usize], values: Vec<f32>) -> Array {
        match &self.backend {
            Backend::Cpu => Array::on_cpu(shape, values),
            Backend::Gpu(gpu) => {
                let expected: usize = shape.iter().product();
                assert_eq!(
                    values.len(),
                    expected,
                    "array: {} values do not fill the shape {shape:?}",
                    values.len()
                );
                Array::on_gpu(gpu, shape, gpu.upload(bytemuck::cast_slice(&values)))
            }
        }
    }

    /// An array of zeros.
    pub fn zeros(&self, shape: &[usize]) -> Array {
        self.full(shape, 0.0)
    }

    /// An array with every element equal to `value`.
    pub fn full(&self, shape: &[usize], value: f32) -> Array {
        let len = shape.iter().product();
        match &self.backend {
            Backend::Cpu => Array::on_cpu(shape, vec![value; len]),
            Backend::Gpu(gpu) => Array::on_gpu(gpu, shape, gpu::map::fill(gpu, len, value)),
        }
    }
}
