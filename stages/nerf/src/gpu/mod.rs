//! The field on a GPU: the same training and the same images as on the CPU, by kernels of WGSL
//! (`wgsl/*.wgsl`).
//!
//! Values come back only once per step, and while they do the device goes on: it is never told how
//! many samples there are. Every sum has one order, or is one of whole numbers; the same adapter
//! and driver give the same bits. Faults unwind to [`compute::device::attempt`].

mod batch;
mod check;
mod moments;
mod occupancy_update;
mod params;
mod programs;
mod render;
mod resident;
mod trace;
mod train;
mod work;

pub use check::{Check, check};
pub use render::Renderer;
pub use train::GpuTrainer;
pub use work::Work;
