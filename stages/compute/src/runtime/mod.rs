//! What operators are written with: arrays and weights on a device, random numbers, and in `cpu`
//! and `gpu` what their kernels share. It knows no operator.

pub mod array;
pub mod cpu;
pub mod device;
pub mod format;
pub mod gpu;
pub mod rng;
pub mod stored;
pub mod weight;
