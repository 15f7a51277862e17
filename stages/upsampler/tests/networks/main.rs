//! Whole networks: against PyTorch's numbers, in tiles, on a GPU, and out of files that are not as
//! they should be.

#![allow(clippy::unwrap_used)] // The helpers of tests are tests too.

mod damage;
mod golden;
mod refusals;
mod running;
mod support;
