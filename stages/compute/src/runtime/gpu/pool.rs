//! Device memory that is used again: a buffer that is dropped waits for the next one of its size.
//! It knows sizes and the order of submissions, not what the bytes mean.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Bytes of the smallest buffer: shorter ones are rounded up, so that there are few sizes.
const SMALLEST: u64 = 256;

/// Bytes on the device, which return to their pool when dropped.
#[derive(Debug)]
pub struct Buffer {
    raw: wgpu::Buffer,
    /// Bytes in use; the buffer may be longer.
    bytes: u64,
    pool: Arc<BufferPool>,
}

impl Buffer {
    /// What commands are recorded with.
    pub fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }

    /// Bytes in use, a multiple of 4 and at least 4.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        let mut idle = self.pool.lock();
        idle.in_use -= self.raw.size();
        let waiting = Waiting {
            raw: self.raw.clone(),
            // Commands recorded up to now may use it.
            batch: idle.batch,
        };
        idle.buffers
            .entry(self.raw.size())
            .or_default()
            .push(waiting);
    }
}

/// All memory of one device.
#[derive(Debug, Default)]
pub struct BufferPool {
    idle: Mutex<Idle>,
}

#[derive(Debug, Default)]
struct Idle {
    buffers: BTreeMap<u64, Vec<Waiting>>,
    /// The number of the batch being recorded.
    batch: u64,
    in_use: u64,
}

#[derive(Debug)]
struct Waiting {
    raw: wgpu::Buffer,
    /// The batch in which it may have been used last.
    batch: u64,
}

/// Who writes a buffer first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Writer {
    /// A kernel of the batch being recorded: any idle buffer will do, since commands run in their
    /// order.
    Kernel,
    /// The host, ahead of that batch: only a buffer that the batch has not used.
    Host,
}

/// Sizes are rounded up to four steps per power of two, so that buffers of nearly equal size can
/// stand for each other.
fn class(bytes: u64) -> u64 {
    let bytes = bytes.max(SMALLEST);
    // Four steps waste a fifth at most, and sizes that differ little share buffers.
    bytes.next_multiple_of((bytes.next_power_of_two() / 8).max(4))
}

impl BufferPool {
    fn lock(&self) -> MutexGuard<'_, Idle> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A buffer of at least `bytes`, and at most `largest` where those are no more, with any
    /// content; `create` makes one where none is idle.
    pub fn take(
        self: &Arc<Self>,
        bytes: u64,
        largest: u64,
        writer: Writer,
        create: impl FnOnce(u64) -> wgpu::Buffer,
    ) -> Buffer {
        let bytes = bytes.next_multiple_of(4).max(4);
        let size = class(bytes).min(largest).max(bytes);
        // The lock is open meanwhile, since `create` may clear the pool.
        let raw = self.idle(size, writer).unwrap_or_else(|| create(size));
        self.lock().in_use += raw.size();
        Buffer {
            raw,
            bytes,
            pool: self.clone(),
        }
    }

    fn idle(&self, size: u64, writer: Writer) -> Option<wgpu::Buffer> {
        let mut idle = self.lock();
        let batch = idle.batch;
        let waiting = idle.buffers.get_mut(&size)?;
        let usable = |waiting: &Waiting| writer == Writer::Kernel || waiting.batch < batch;
        // The latest first: it is the likeliest to be in a cache.
        let at = waiting.iter().rposition(usable)?;
        Some(waiting.swap_remove(at).raw)
    }

    /// Another batch begins: what was used before has been handed to the device.
    pub fn next_batch(&self) {
        self.lock().batch += 1;
    }

    /// Gives idle memory back to the driver.
    pub fn clear(&self) {
        self.lock().buffers.clear();
    }

    /// Bytes of all memory, in use or idle.
    pub fn held(&self) -> u64 {
        let idle = self.lock();
        idle.in_use
            + idle
                .buffers
                .iter()
                .map(|(size, buffers)| size * buffers.len() as u64)
                .sum::<u64>()
    }
}

#[cfg(test)]
mod tests {
    use super::class;

    #[test]
    fn a_size_class_wastes_a_quarter_at_most() {
        for bytes in (1..100_000).step_by(37) {
            let size = class(bytes);
            assert!(
                size >= bytes
                    && size.is_multiple_of(4)
                    && (size <= 256 || size < bytes + bytes / 4 + 4),
                "{bytes}: {size}"
            );
        }
    }
}
