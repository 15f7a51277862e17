//! An open GPU: what it is, and what was handed to it. It knows no kernel. Its faults unwind to
//! [`super::fault::attempt`].

use std::panic::resume_unwind;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::adapter::{self, Found};
use super::counts::Counts;
use super::error::GpuError;
use super::fault::{FirstError, lock, watch};
use super::pipeline::Pipelines;
use super::pool::BufferPool;
use super::recorder::Recorder;
use super::tuning::Tuning;

/// How long a device that refused a command has to say that it is lost.
const LAST_WORDS: Duration = Duration::from_secs(5);

/// The most bytes of one array: kernels count its elements in 31 bits.
const LARGEST: u64 = 4 << 31;
/// Pieces of an array begin at multiples of so many bytes, which suits every adapter.
const ALIGNED: u64 = 256;

/// An adapter that is open for computing.
pub struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    kind: String,
    hardware: bool,
    halves: bool,
    /// The most bytes of one array.
    pub(super) largest: u64,
    /// The most bytes of an array that a kernel sees at one binding.
    pub(super) window: u64,
    /// The most bindings of a kernel.
    pub(super) bindings: usize,
    tuning: Mutex<Tuning>,
    /// The most bytes that all arrays may take together; only tests set any.
    pub(super) memory: AtomicU64,
    pub(super) pool: Arc<BufferPool>,
    pub(super) work: Mutex<Work>,
    fault: FirstError,
}

/// What operators of several threads share.
pub(super) struct Work {
    pub(super) pipelines: Pipelines,
    pub(super) recorder: Recorder,
    pub(super) counts: Counts,
}

/// The arrays that a kernel of a weak adapter sees: as many as under lavapipe.
const WEAK_BINDINGS: u32 = 32;

impl Gpu {
    /// Opens the adapter numbered `index`, or the first that is hardware; with a `window` as if it
    /// were a weak one, whose kernels see so many bytes of an array at once, and few of them, and
    /// name no numbers of 16 bits.
    pub fn open(index: Option<usize>, window: Option<u64>) -> Result<Gpu, GpuError> {
        let Found { adapter, report } = adapter::choose(index)?;
        let mut limits = adapter.limits();
        // Nothing else that the adapter offers is used.
        let mut required_features = adapter.features() & wgpu::Features::SHADER_F16;
        if let Some(window) = window {
            limits.max_storage_buffer_binding_size =
                limits.max_storage_buffer_binding_size.min(window);
            limits.max_storage_buffers_per_shader_stage = limits
                .max_storage_buffers_per_shader_stage
                .min(WEAK_BINDINGS);
            required_features = wgpu::Features::empty();
        }
        let required_limits = limits.clone();
        let descriptor = wgpu::DeviceDescriptor {
            required_features,
            required_limits,
            ..Default::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| {
                GpuError::Unfit {
                    adapter: report.name.clone(),
                    reason: error.to_string(),
                }
            })?;
        let fault = FirstError::default();
        let pool = Arc::default();
        watch(&device, &fault, &pool);
        let work = Work {
            pipelines: Pipelines::default(),
            recorder: Recorder::new(&device),
            counts: Counts::default(),
        };
        Ok(Gpu {
            hardware: report.hardware,
            halves: required_features.contains(wgpu::Features::SHADER_F16),
            kind: format!("gpu: {}, {} {}", report.name, report.backend, report.driver),
            // Down to whole pieces, so that no array ends within one's alignment.
            largest: limits.max_buffer_size.min(LARGEST) / ALIGNED * ALIGNED,
            window: limits.max_storage_buffer_binding_size / ALIGNED * ALIGNED,
            bindings: limits.max_storage_buffers_per_shader_stage as usize,
            tuning: Mutex::default(),
            memory: AtomicU64::new(u64::MAX),
            pool,
            work: Mutex::new(work),
            device,
            queue,
            fault,
        })
    }

    /// What results depend on: the adapter and its driver.
    pub fn kind(&self) -> &str {
        &self.kind
    }

    /// Whether it is hardware, not a program on the CPU.
    pub fn is_hardware(&self) -> bool {
        self.hardware
    }

    /// Whether kernels can name numbers of 16 bits.
    pub fn has_halves(&self) -> bool {
        self.halves
    }

    /// In which tiles products are computed.
    pub fn tuning(&self) -> Tuning {
        *lock(&self.tuning)
    }

    /// Takes other tiles from now on.
    pub fn tune(&self, tuning: Tuning) {
        *lock(&self.tuning) = tuning;
    }

    /// What was done so far.
    pub fn counts(&self) -> Counts {
        let work = lock(&self.work);
        Counts {
            pipelines: work.pipelines.count(),
            ..work.counts
        }
    }

    /// Stops whatever runs on the device, up to the nearest [`super::fault::attempt`].
    pub(super) fn fail(&self, error: GpuError) -> ! {
        // A command may be refused since the device is lost, of which it tells when asked after all
        // work is over.
        let _ = self.device.poll(wgpu::PollType::Wait {
            submission_index: None,
            timeout: Some(LAST_WORDS),
        });
        let mut fault = lock(&self.fault);
        // The first fault told of is the cause; what comes later comes of it.
        let first = fault.get_or_insert(error).clone();
        drop(fault);
        resume_unwind(Box::new(first))
    }

    /// Stops whatever runs on a device that has told of a fault.
    pub(super) fn check(&self) {
        let fault = lock(&self.fault).clone();
        if let Some(error) = fault {
            self.fail(error);
        }
    }

    /// Takes the device away, as the reset of a driver does.
    pub(crate) fn lose(&self) {
        self.device.destroy();
    }

    pub(super) fn hand_over(&self, work: &mut Work) -> Option<wgpu::SubmissionIndex> {
        let submission = work.recorder.submit(&self.queue)?;
        work.counts.submissions += 1;
        // From here on the host may write into what this batch used: its writes come behind it in
        // the queue.
        self.pool.next_batch();
        Some(submission)
    }

    /// Hands over what is recorded.
    pub fn submit(&self) {
        self.hand_over(&mut lock(&self.work));
    }

    /// Waits until all that was handed over is done.
    pub fn wait(&self) {
        self.wait_for(None);
    }

    /// Waits until one batch is done, or all that was handed over.
    pub(super) fn wait_for(&self, submission_index: Option<wgpu::SubmissionIndex>) {
        if let Err(error) = self.device.poll(wgpu::PollType::Wait {
            submission_index,
            timeout: None,
        }) {
            self.fail(GpuError::Lost(error.to_string()));
        }
        // A fault may have been told of while waiting.
        self.check();
    }
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.kind)
    }
}
