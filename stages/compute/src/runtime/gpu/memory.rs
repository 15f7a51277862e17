//! The memory of an open GPU: arrays taken from its pool, filled from the host and read back. Knows
//! no kernel.

use std::panic::resume_unwind;
use std::sync::atomic::Ordering;

use super::context::Gpu;
use super::error::GpuError;
use super::fault::{full, lock, too_large};
use super::pool::{Buffer, Writer};

/// Numbers on their way to the host.
pub struct Requested {
    staging: wgpu::Buffer,
    submission: Option<wgpu::SubmissionIndex>,
}

impl Gpu {
    /// Memory for `len` numbers of 32 bits, with any content.
    pub fn buffer(&self, len: usize) -> Buffer {
        self.take(4 * len as u64, Writer::Kernel)
    }

    /// The bytes on the device, filled up to a multiple of 4.
    pub fn upload(&self, bytes: &[u8]) -> Buffer {
        let buffer = self.take(bytes.len() as u64, Writer::Host);
        // wgpu writes multiples of four bytes only.
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
            too_large(bytes, self.largest);
        }
        self.pool
            .take(bytes, self.largest, writer, |size| self.create(size))
    }

    /// New memory; if there is none left, after giving back what is idle.
    fn create(&self, size: u64) -> wgpu::Buffer {
        self.try_create(size).unwrap_or_else(|| {
            // Idle buffers may still be read by commands not run yet: these run first.
            self.submit();
            self.wait();
            self.pool.clear();
            // The device goes on: there may be room for another stage.
            let full = || resume_unwind(Box::new(full(&self.pool)));
            self.try_create(size).unwrap_or_else(full)
        })
    }

    fn try_create(&self, size: u64) -> Option<wgpu::Buffer> {
        use wgpu::BufferUsages as Usages;
        if self.pool.held().saturating_add(size) > self.memory.load(Ordering::Relaxed) {
            return None;
        }
        // A scope of its own: out of memory here is an answer, not a fault of the device.
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size,
            usage: Usages::STORAGE | Usages::COPY_SRC | Usages::COPY_DST,
            mapped_at_creation: false,
        });
        pollster::block_on(scope.pop()).is_none().then_some(buffer)
    }

    /// Refuses arrays that would take more than so many bytes together, as full memory does.
    pub(crate) fn limit_memory(&self, bytes: u64) {
        self.memory.store(bytes, Ordering::Relaxed);
    }

    /// The first `len` numbers of an array, once all commands before are done.
    pub fn read(&self, buffer: &Buffer, len: usize) -> Vec<f32> {
        if len == 0 {
            Vec::new()
        } else {
            self.receive(self.request(buffer, len))
        }
    }

    /// Asks for the first `len` numbers of an array (at least one) as they are after all commands
    /// so far. Later commands can be recorded, and run, before they are received.
    pub fn request(&self, buffer: &Buffer, len: usize) -> Requested {
        let bytes = 4 * len as u64;
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size: bytes,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut work = lock(&self.work);
        work.recorder
            .copy(&self.device, buffer.raw(), &staging, bytes);
        // Handed over at once, since the host waits for it.
        let submission = self.hand_over(&mut work);
        work.counts.read_backs += 1;
        drop(work);
        // Answered once the commands are done, which `receive` waits for.
        staging.map_async(wgpu::MapMode::Read, .., |_| ());
        Requested {
            staging,
            submission,
        }
    }

    /// The numbers that were asked for. Waits for the commands before the request, not for those
    /// after it.
    pub fn receive(
        &self,
        Requested {
            staging,
            submission,
        }: Requested,
    ) -> Vec<f32> {
        self.wait_for(submission);
        let mapped = staging.get_mapped_range(..);
        let mapped = mapped.unwrap_or_else(|error| self.fail(GpuError::Lost(error.to_string())));
        let values = mapped
            .as_chunks()
            .0
            .iter()
            .map(|bytes| f32::from_ne_bytes(*bytes))
            .collect();
        drop(mapped);
        values
    }
}
