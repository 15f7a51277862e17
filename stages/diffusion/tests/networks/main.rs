//! The networks: beside those of diffusers, in training, on images of any size, and when their
//! files are damaged.

#![allow(clippy::unwrap_used)] // The helpers of tests are tests too.

mod autoencoder;
mod golden;
mod gpu;
mod loading;
mod mutations;
mod single_file;
mod support;
mod training;
