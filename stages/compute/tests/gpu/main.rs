//! The GPU's operators beside the CPU's, on whatever adapter comes first: a software one does.
//! Where there is none the tests pass with a message, unless `SRNERF_REQUIRE_GPU` is set, as `make
//! test` does.

mod common;
mod operators;
mod pieces;
mod residency;
