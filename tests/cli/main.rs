//! The command as users meet it: transcripts with the real binary on a tiny pipeline.

#![allow(clippy::unwrap_used)]

mod arms;
mod checkpoint;
mod completions;
mod concurrent;
mod corrections;
mod costs;
mod damage;
mod damage_store;
mod dcc;
mod explain;
mod export;
mod golden;
mod gpu;
mod hub;
mod import;
mod init;
mod kinds;
mod layouts;
mod loras;
mod mistakes;
mod model;
mod remote;
mod runs;
mod s3;
mod scenes;
mod shards;
mod single_file;
mod soak;
mod space;
mod space_kept;
mod splats;
mod standing;
mod tev;
mod trust;
mod tutorial;
mod upsample;
mod view;
mod view_pictures;
mod viewer;
mod watch;
mod whole;
