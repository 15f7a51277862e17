//! An open GPU: its memory, its kernels, and the commands recorded for it. It knows no operator.
//!
//! Operators have no errors of their own, so a fault of the device unwinds to [`attempt`] with a [`GpuError`] as its
//! load; no panic hook sees it.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::adapter::{self, Found};
use super::counts::Counts;
use super::error::GpuError;
use super::kernel::{Kernel, Kernels};
use super::pool::{Buffer, Pool, Writer};
use super::recorder::Recorder;

/// The most workgroups along one axis.
const GROUPS: u32 = 65_535;

/// An adapter that is open for computing.
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    kind: String,
    largest: u64,
    pool: Arc<Pool>,
    work: Mutex<Work>,
    fault: Fault,
}

/// What operators of several threads share.
struct Work {
    kernels: Kernels,
    recorder: Recorder,
    counts: Counts,
}

/// The first thing that went wrong.
type Fault = Arc<Mutex<Option<GpuError>>>;

/// One use of a kernel.
pub struct Job<'a> {
    /// What to run.
    pub kernel: &'a Kernel,
    /// What it reads, then what it writes.
    pub arrays: &'a [&'a Buffer],
    /// Its parameters; floats by their bits.
    pub words: &'a [u32],
    /// How many workgroups along each axis.
    pub groups: [u32; 3],
    /// Floating-point operations.
    pub operations: u64,
}

/// Numbers on their way to the host.
pub struct Requested {
    staging: wgpu::Buffer,
    submission: Option<wgpu::SubmissionIndex>,
}

/// Runs what computes on a GPU, and gives the fault that stopped it, if one did.
pub fn attempt<T>(run: impl FnOnce() -> T) -> Result<T, GpuError> {
    catch_unwind(AssertUnwindSafe(run)).map_err(|load| match load.downcast::<GpuError>() {
        Ok(error) => *error,
        Err(panic) => resume_unwind(panic),
    })
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn mib(bytes: u64) -> u64 {
    bytes.div_ceil(1 << 20)
}

impl Gpu {
    /// Opens the adapter numbered `index`, or the first that is hardware.
    pub fn open(index: Option<usize>) -> Result<Gpu, GpuError> {
        let Found { adapter, report } = adapter::choose(index)?;
        let limits = adapter.limits();
        let descriptor = wgpu::DeviceDescriptor { required_limits: limits.clone(), ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| GpuError::Unfit { adapter: report.name.clone(), reason: error.to_string() })?;
        let fault = Fault::default();
        watch(&device, &fault);
        let work = Work { kernels: Kernels::default(), recorder: Recorder::new(&device), counts: Counts::default() };
        Ok(Gpu {
            kind: format!("gpu: {}, {} {}", report.name, report.backend, report.driver),
            largest: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) / 4 * 4,
            pool: Arc::default(),
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

    /// What was done so far.
    pub fn counts(&self) -> Counts {
        let work = lock(&self.work);
        Counts { pipelines: work.kernels.count(), ..work.counts }
    }

    /// Stops whatever runs on the device, up to the nearest [`attempt`].
    fn fail(&self, error: GpuError) -> ! {
        let mut fault = lock(&self.fault);
        let first = fault.get_or_insert(error).clone();
        drop(fault);
        resume_unwind(Box::new(first))
    }

    fn check(&self) {
        let fault = lock(&self.fault).clone();
        if let Some(error) = fault {
            self.fail(error);
        }
    }

    /// Memory for `len` numbers of 32 bits, with any content.
    pub fn buffer(&self, len: usize) -> Buffer {
        self.take(4 * len as u64, Writer::Kernel)
    }

    /// The bytes on the device, filled up to a multiple of 4.
    pub fn upload(&self, bytes: &[u8]) -> Buffer {
        let buffer = self.take(bytes.len() as u64, Writer::Host);
        let whole = bytes.len() / 4 * 4;
        self.queue.write_buffer(buffer.raw(), 0, &bytes[..whole]);
        if whole < bytes.len() {
            let mut last = [0; 4];
            last[..bytes.len() - whole].copy_from_slice(&bytes[whole..]);
            self.queue.write_buffer(buffer.raw(), whole as u64, &last);
        }
        lock(&self.work).counts.uploaded += bytes.len() as u64;
        buffer
    }

    fn take(&self, bytes: u64, writer: Writer) -> Buffer {
        if bytes > self.largest {
            let (asked, limit) = (mib(bytes), self.largest >> 20);
            resume_unwind(Box::new(GpuError::TooLarge { asked, limit }));
        }
        self.pool.take(bytes, self.largest, writer, |size| self.create(size))
    }

    /// New memory; if there is none left, after giving back what is idle.
    fn create(&self, size: u64) -> wgpu::Buffer {
        self.try_create(size).unwrap_or_else(|| {
            self.submit();
            self.wait();
            self.pool.clear();
            let full = || self.fail(GpuError::OutOfMemory { asked: mib(size), held: mib(self.pool.in_use()) });
            self.try_create(size).unwrap_or_else(full)
        })
    }

    fn try_create(&self, size: u64) -> Option<wgpu::Buffer> {
        use wgpu::BufferUsages as Usages;
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size,
            usage: Usages::STORAGE | Usages::COPY_SRC | Usages::COPY_DST,
            mapped_at_creation: false,
        });
        pollster::block_on(scope.pop()).is_none().then_some(buffer)
    }

    /// Records a job. It runs when a batch is full, or when values are read.
    pub fn run(&self, job: &Job) {
        self.start(job);
        self.account(job.operations, job.arrays.iter().map(|array| array.bytes()).sum());
    }

    /// Adds to what was done: operations, and bytes through device memory.
    pub fn account(&self, operations: u64, bytes: u64) {
        let mut work = lock(&self.work);
        work.counts.operations += operations;
        work.counts.bytes += bytes;
    }

    /// Records a job that touches a part of its arrays which only the device knows: whoever learns of it tells
    /// [`Gpu::account`].
    pub fn start(&self, job: &Job) {
        self.check();
        assert!(job.groups.iter().all(|&count| count <= GROUPS), "{}: {:?} workgroups", job.kernel.name, job.groups);
        if job.groups.contains(&0) {
            return;
        }
        let mut work = lock(&self.work);
        if work.recorder.is_full() {
            self.hand_over(&mut work);
        }
        let pipeline = work.kernels.get(&self.device, job.kernel);
        let arrays: Vec<_> = job.arrays.iter().map(|array| (array.raw(), array.bytes())).collect();
        work.recorder.dispatch(&self.device, &pipeline, &arrays, job.words, job.groups);
        work.counts.dispatches += 1;
    }

    fn hand_over(&self, work: &mut Work) -> Option<wgpu::SubmissionIndex> {
        let submission = work.recorder.submit(&self.queue)?;
        work.counts.submissions += 1;
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
    fn wait_for(&self, submission_index: Option<wgpu::SubmissionIndex>) {
        if let Err(error) = self.device.poll(wgpu::PollType::Wait { submission_index, timeout: None }) {
            self.fail(GpuError::Lost(error.to_string()));
        }
        self.check();
    }

    /// The first `len` numbers of an array, once all commands before are done.
    pub fn read(&self, buffer: &Buffer, len: usize) -> Vec<f32> {
        if len == 0 { Vec::new() } else { self.receive(self.request(buffer, len)) }
    }

    /// Asks for the first `len` numbers of an array (at least one) as they are after all commands so far. Later
    /// commands can be recorded, and run, before they are received.
    pub fn request(&self, buffer: &Buffer, len: usize) -> Requested {
        let bytes = 4 * len as u64;
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size: bytes,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut work = lock(&self.work);
        work.recorder.copy(&self.device, buffer.raw(), &staging, bytes);
        let submission = self.hand_over(&mut work);
        work.counts.read_backs += 1;
        drop(work);
        staging.map_async(wgpu::MapMode::Read, .., |_| ());
        Requested { staging, submission }
    }

    /// The numbers that were asked for. Waits for the commands before the request, not for those after it.
    pub fn receive(&self, Requested { staging, submission }: Requested) -> Vec<f32> {
        self.wait_for(submission);
        let mapped = staging.get_mapped_range(..);
        let mapped = mapped.unwrap_or_else(|error| self.fail(GpuError::Lost(error.to_string())));
        let values = mapped.as_chunks().0.iter().map(|bytes| f32::from_ne_bytes(*bytes)).collect();
        drop(mapped);
        values
    }
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.kind)
    }
}

/// Keeps the first fault that the driver tells of.
fn watch(device: &wgpu::Device, fault: &Fault) {
    let keep = |fault: &Fault, error: GpuError| {
        lock(fault).get_or_insert(error);
    };
    let (errors, losses) = (fault.clone(), fault.clone());
    device.on_uncaptured_error(Arc::new(move |error| {
        keep(
            &errors,
            match error {
                wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory { asked: 0, held: 0 },
                wgpu::Error::Validation { description, .. } | wgpu::Error::Internal { description, .. } => {
                    GpuError::Refused(description)
                }
            },
        );
    }));
    device.set_device_lost_callback(move |reason, message| {
        if reason != wgpu::DeviceLostReason::Destroyed {
            keep(&losses, GpuError::Lost(message));
        }
    });
}
