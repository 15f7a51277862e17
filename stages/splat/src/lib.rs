//! Gaussian splats of what is known of a scene as pictures with depths: seeded on its surface,
//! fitted to the pictures, and written as other programs read them.
//!
//! Everything has one order: the same pictures give the same bits for any number of threads. Knows
//! no fields and no artifacts.
//!
//! ```
//! use formats::Camera;
//! use splat::{Colors, Fit, Picture, Seeds, render};
//!
//! // A grey wall, 4 in front of the camera.
//! let camera = Camera::centered((16, 12), 20.0, glam::DMat4::IDENTITY, [1.0, 9.0]);
//! let depth = vec![4.0; 16 * 12];
//! let picture = Picture { pixels: vec![[0.5, 0.5, 0.5, 1.0]; 16 * 12] };
//!
//! let mut seeds = Seeds::new(1000, depth.len());
//! seeds.add_view(&camera, &depth, &vec![1.0; depth.len()]);
//! let mut cloud = seeds.cloud(0)?;
//! let mut colors = Colors::new(&cloud);
//! colors.add_view(&cloud, &camera, &picture, &depth);
//! colors.settle(&mut cloud);
//!
//! let mut fit = Fit::new(cloud, 20);
//! while fit.goes_on() {
//!     fit.step(&camera, &picture);
//! }
//! let drawn = render(&fit.cloud(), &camera);
//! assert!((drawn.pixels[6 * 16 + 8][0] - 0.5).abs() < 0.1);
//! # Ok::<(), splat::SeedError>(())
//! ```

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
pub use fit::Fit;
pub use harmonics::HIGHEST as HIGHEST_DEGREE;
pub use picture::{Picture, pinhole, psnr};
pub use raster::render;
pub use seed::{Seed, SeedError, Seeds, normals};
