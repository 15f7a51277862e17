//! Gaussian splats of what is known of a scene as pictures with depths: seeded on its surface,
//! fitted to the pictures, and written as other programs read them.
//!
//! Everything has one order: the same pictures give the same bits for any number of threads. Knows
//! no fields and no artifacts.

mod adam;
mod cloud;
mod colors;
pub mod files;
mod fit;
mod harmonics;
mod picture;
mod project;
mod raster;
mod seed;
mod tiles;

pub use cloud::{Cloud, Splat};
pub use colors::Colors;
pub use fit::{Fit, FitOptions};
pub use harmonics::HIGHEST as HIGHEST_DEGREE;
pub use picture::{Picture, pinhole, psnr};
pub use raster::render;
pub use seed::{Seed, SeedError, SeedOptions, Seeds};
