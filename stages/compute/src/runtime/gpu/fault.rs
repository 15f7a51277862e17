//! What goes wrong with a GPU, and how that stops whoever computes on it.
//!
//! Operators have no errors of their own, so a fault of the device unwinds to [`attempt`] with a
//! [`GpuError`] as its load; no panic hook sees it.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::error::GpuError;
use super::pool::BufferPool;

/// The fault that the device has told of.
pub type FirstError = Arc<Mutex<Option<GpuError>>>;

/// Runs what computes on a GPU, and gives the fault that stopped it, if one did.
pub fn attempt<T>(run: impl FnOnce() -> T) -> Result<T, GpuError> {
    catch_unwind(AssertUnwindSafe(run)).map_err(|load| match load.downcast::<GpuError>() {
        Ok(error) => *error,
        // Any other panic is a bug, and goes on as one.
        Err(panic) => resume_unwind(panic),
    })
}

/// Stops what asks for more than a kernel can see; the device goes on.
pub fn too_large(asked: u64, limit: u64) -> ! {
    resume_unwind(Box::new(GpuError::TooLarge {
        asked: mib(asked),
        limit: limit >> 20,
    }))
}

/// There is no more memory.
pub fn full(pool: &BufferPool) -> GpuError {
    GpuError::OutOfMemory {
        held: mib(pool.held()),
    }
}

/// Keeps the first fault that the driver tells of; a loss, which other faults may come of, before
/// any other.
pub fn watch(device: &wgpu::Device, fault: &FirstError, pool: &Arc<BufferPool>) {
    // The pool keeps the device alive, which must not keep the pool.
    let errors = fault.clone();
    let losses = fault.clone();
    let pool = Arc::downgrade(pool);
    device.on_uncaptured_error(Arc::new(move |error| {
        let fault = match error {
            wgpu::Error::OutOfMemory { .. } => pool
                .upgrade()
                .map_or(GpuError::OutOfMemory { held: 0 }, |pool| full(&pool)),
            wgpu::Error::Validation { description, .. }
            | wgpu::Error::Internal { description, .. } => GpuError::Refused(description),
        };
        lock(&errors).get_or_insert(fault);
    }));
    device.set_device_lost_callback(move |reason, message| {
        let why = if message.is_empty() {
            format!("{reason:?}")
        } else {
            message
        };
        // In place of what was there: a refused command may be the loss's first sign.
        *lock(&losses) = Some(GpuError::Lost(why));
    });
}

/// What is behind a lock, whoever panicked while holding it.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn mib(bytes: u64) -> u64 {
    bytes.div_ceil(1 << 20)
}
