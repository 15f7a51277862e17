//! Cameras and their conventions, readers of posed photos, and procedural scenes.
//!
//! Everything here follows `docs/conventions.md`: OpenGL axes, pixel centres at +0.5, sRGB-encoded photos, depth along
//! the view axis. Readers bring foreign conventions into these at the door; nothing behind them knows others.

mod camera;
mod colmap;
pub mod color;
mod distortion;
mod downscale;
mod error;
mod image_file;
mod llff;
mod llff_files;
mod normalize;
mod npy;
mod path;
mod photo;
mod pose;
mod procedural;
mod source_files;
mod transforms;

pub use camera::{Camera, Ray};
pub use colmap::{colmap, colmap_digest};
pub use distortion::Distortion;
pub use downscale::{Reduction, downscale};
pub use error::SceneError;
pub use llff::llff;
pub use llff_files::llff_digest;
pub use path::{circle, path_digest, path_from_file, spiral};
pub use photo::{Photo, SceneData, split_holdout};
pub use procedural::{object, still_life};
pub use transforms::{TransformsOptions, transforms, transforms_digest, write_transforms};
