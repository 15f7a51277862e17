//! How much a device was given to do. A figure of its own for each thing that costs time, so that a
//! test sees a regression where no GPU is.

use std::ops::Sub;

/// What was done since the device was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Kernels that were started.
    pub dispatches: u64,
    /// Batches of commands handed over.
    pub submissions: u64,
    /// Times that the host waited for values.
    pub read_backs: u64,
    /// Floating-point operations, a multiplication and its addition being two.
    pub operations: u64,
    /// Bytes that kernels take from and put into device memory if each array goes through once.
    pub bytes: u64,
    /// Bytes from the host.
    pub uploaded: u64,
    /// Pipelines that were compiled: one for each kernel and class of shapes.
    pub pipelines: u64,
}

impl Sub for Counts {
    type Output = Counts;

    fn sub(self, before: Counts) -> Counts {
        Counts {
            dispatches: self.dispatches - before.dispatches,
            submissions: self.submissions - before.submissions,
            read_backs: self.read_backs - before.read_backs,
            operations: self.operations - before.operations,
            bytes: self.bytes - before.bytes,
            uploaded: self.uploaded - before.uploaded,
            pipelines: self.pipelines - before.pipelines,
        }
    }
}
