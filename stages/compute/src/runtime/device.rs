//! Where arrays live and operators run. It knows which back ends exist, not what they compute nor
//! what an array is.

use std::sync::Arc;

use super::cpu::simd::Level;
use super::gpu::adapter;
use super::gpu::context::Gpu;

pub use super::gpu::adapter::{HALVES, Report};
pub use super::gpu::counts::Counts;
pub use super::gpu::error::GpuError;
pub use super::gpu::fault::attempt;

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

    /// A GPU as [`Device::gpu`] opens it, as if the adapter were a weak one ([`Gpu::open`]).
    pub(crate) fn weak_gpu(index: Option<usize>, window: u64) -> Result<Device, GpuError> {
        Ok(Device {
            backend: Backend::Gpu(Arc::new(Gpu::open(index, Some(window))?)),
        })
    }

    /// The first GPU that is hardware and can run our kernels, else the CPU. Where the system shows
    /// that there is no such hardware, no driver is asked.
    pub fn auto() -> Device {
        if adapter::hardware_is_likely() {
            // A GPU that cannot be opened is no error here: nobody asked for it.
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
        Ok(adapter::find()?
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
            Backend::Cpu => Level::current().name(),
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
}
