//! What a camera, a lens and a scene box are, in memory and in every file that holds one.
//!
//! The lowest floor beside `compute`: artifacts, readers of scenes and the field all take these
//! types, so that nothing is converted between them. Knows no stages and no artifacts.

pub mod bounds;
pub mod camera;
pub mod color;
mod distortion;
pub mod rows;

pub use bounds::Bounds;
pub use camera::{Camera, CameraError, Ray};
pub use distortion::Distortion;
