//! Two coloured spheres before a coloured wall, ray-traced here: a field fitted to eight small
//! views of them shows a ninth, trains to the same bits on any number of threads, and goes on from
//! a saved state as if it had never stopped.

#![allow(clippy::unwrap_used)] // Helpers of tests count as tests.

mod common;
mod gpu;
mod training;
