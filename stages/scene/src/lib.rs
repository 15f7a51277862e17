//! Cameras and their conventions, readers of posed photos, and procedural scenes.
//!
//! Everything here follows `docs/conventions.md`: OpenGL axes, pixel centres at +0.5, sRGB-encoded photos, depth along
//! the view axis. Readers bring foreign conventions into these at the door; nothing behind them knows others.

mod camera;
pub mod color;
mod error;
mod photo;

pub use camera::{Camera, Ray};
pub use error::SceneError;
pub use photo::{Photo, SceneData, split_holdout};
