//! The command as users meet it: transcripts with the real binary on a tiny pipeline.

#![allow(clippy::unwrap_used)]

mod checkpoint;
mod damage;
mod mistakes;
mod runs;
mod space;
mod whole;
