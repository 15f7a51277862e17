//! The command as users meet it: transcripts with the real binary on a tiny pipeline.

#![allow(clippy::unwrap_used)]

mod checkpoint;
mod concurrent;
mod damage;
mod export;
mod mistakes;
mod remote;
mod runs;
mod s3;
mod scenes;
mod shards;
mod soak;
mod space;
mod whole;
