//! Readers of scenes: what is written comes back, what is broken is refused by name, and what
//! people bring is read as `docs/inputs.md` says.

#![allow(clippy::unwrap_used)] // The helpers of tests are tests too.

mod colmap;
mod common;
mod inputs;
mod inputs_page;
mod llff;
mod stream;
mod transforms;
