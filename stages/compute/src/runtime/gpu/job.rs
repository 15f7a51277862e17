//! Uses of kernels, and how they are recorded for an open GPU. They know which arrays a kernel
//! sees, not what it computes.

use super::context::Gpu;
use super::fault::{lock, too_large};
use super::kernel::{Kernel, KernelSource, Pieces};
use super::params::Params;
use super::pipeline::{Pipeline, Pipelines};
use super::pool::Buffer;
use super::recorder::Piece;

/// The most workgroups along one axis.
const GROUPS: u32 = 65_535;

/// One use of a kernel.
pub struct Job<'a, P> {
    /// The kernel to start.
    pub kernel: &'a Kernel<P>,
    /// What it reads, then what it writes.
    pub arrays: &'a [&'a Buffer],
    /// The struct that the kernel sees as `p`.
    pub params: P,
    /// How many workgroups along each axis.
    pub groups: [u32; 3],
    /// Floating-point operations of all its invocations, for [`Counts`](super::counts::Counts).
    pub operations: u64,
}

/// A job whose parameters are bytes.
pub(super) struct Command<'a> {
    pub source: &'a KernelSource,
    pub arrays: &'a [&'a Buffer],
    pub params: &'a [u8],
    pub groups: [u32; 3],
    pub operations: u64,
}

impl<P: Params> Job<'_, P> {
    fn command(&self) -> Command<'_> {
        Command {
            source: self.kernel.source(),
            arrays: self.arrays,
            params: bytemuck::bytes_of(&self.params),
            groups: self.groups,
            operations: self.operations,
        }
    }
}

impl Command<'_> {
    /// Bytes of all arrays together.
    fn bytes(&self) -> u64 {
        self.arrays.iter().map(|array| array.bytes()).sum()
    }

    /// In how many pieces its arrays lie, where a kernel sees so many bytes of one at once.
    fn pieces(&self, window: u64) -> Pieces {
        let count = |array: &&Buffer| array.bytes().div_ceil(window) as u32;
        Pieces {
            counts: self.arrays.iter().map(count).collect(),
            window,
        }
    }
}

impl Gpu {
    /// Records a job. It runs when a batch is full, or when values are read.
    pub fn run<P: Params>(&self, job: &Job<P>) {
        self.run_command(&job.command());
    }

    /// Records a job that touches a part of its arrays which only the device knows: whoever learns
    /// of it tells [`Gpu::account`].
    pub fn start<P: Params>(&self, job: &Job<P>) {
        self.record(&job.command());
    }

    /// Adds to what was done: operations, and bytes through device memory.
    pub fn account(&self, operations: u64, bytes: u64) {
        let mut work = lock(&self.work);
        work.counts.operations += operations;
        work.counts.bytes += bytes;
    }

    pub(super) fn run_command(&self, command: &Command) {
        self.record(command);
        self.account(command.operations, command.bytes());
    }

    fn record(&self, command: &Command) {
        // Whoever goes on after a fault is stopped at the next command.
        self.check();
        assert!(
            command.groups.iter().all(|&count| count <= GROUPS),
            "{}: {:?} workgroups",
            command.source.name,
            command.groups
        );
        if command.groups.contains(&0) {
            return;
        }
        let mut work = lock(&self.work);
        // Before the pipeline is looked up: its arrays must all be of one batch.
        if work.recorder.is_full() {
            self.hand_over(&mut work);
        }
        let arrays = command.arrays.iter();
        let pieces: Vec<Piece> = arrays.flat_map(|array| self.pieces(array)).collect();
        let pipeline = self.pipeline(&mut work.pipelines, command, pieces.len());
        let params = command.params;
        work.recorder
            .dispatch(&self.device, &pipeline, &pieces, params, command.groups);
        work.counts.dispatches += 1;
    }

    /// An array as kernels see it.
    fn pieces<'b>(&self, array: &'b Buffer) -> impl Iterator<Item = Piece<'b>> + use<'b> {
        let window = self.window;
        let all = array.bytes();
        let piece = move |offset| Piece {
            buffer: array.raw(),
            offset,
            bytes: window.min(all - offset),
        };
        (0..all).step_by(window as usize).map(piece)
    }

    /// The pipeline of a command whose arrays lie in so many pieces in all.
    fn pipeline(&self, known: &mut Pipelines, command: &Command, pieces: usize) -> Pipeline {
        // Each piece takes a binding, of which an adapter has few.
        let pipeline = if pieces > self.bindings {
            None
        } else {
            known.get(&self.device, command.source, &command.pieces(self.window))
        };
        pipeline.unwrap_or_else(|| {
            let most = self.window.saturating_mul(self.bindings as u64);
            too_large(command.bytes(), most)
        })
    }
}
