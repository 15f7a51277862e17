//! Every format that we read or write: what a camera, a lens, a scene box and a tensor are, in
//! memory and in every file that holds one.
//!
//! The lowest floor beside `compute`: artifacts, readers of scenes and the networks all take these
//! types, so that nothing is converted between them. Knows no stages and no artifacts.
//!
//! ```
//! use formats::{Camera, Lens, Pixels, Srgb};
//! use glam::DMat4;
//!
//! // Half of a white pixel, in front of black.
//! let white: Pixels<Srgb> = Pixels::new(vec![1.0; 3], Some(vec![0.5]));
//! assert_eq!(white.before(0.0).rgb, [0.5; 3]);
//!
//! // A camera comes back from what `transforms.json` says of its lens.
//! let camera = Camera::centered((64, 48), 50.0, DMat4::IDENTITY, [1.0, 9.0]);
//! let back = Lens::of(&camera).camera(camera.camera_to_world)?;
//! assert_eq!(back, camera);
//! # Ok::<(), formats::lens::MissingField>(())
//! ```

pub mod bounds;
pub mod camera;
pub mod color;
mod distortion;
mod file_bytes;
pub mod json;
pub mod lens;
pub mod npy;
pub mod openexr;
pub mod pixels;
pub mod rows;
pub mod shot;
mod tensor;
pub mod tensor_file;

pub use bounds::Bounds;
pub use camera::{Camera, CameraError, Ray};
pub use distortion::Distortion;
pub use file_bytes::{FileBytes, FileError, LARGEST_COMPRESSION_RATIO, SharedBytes};
pub use lens::Lens;
pub use pixels::{Linear, Pixels, Srgb};
pub use tensor::{Tensor, TensorView, Values};
pub use tensor_file::{TensorError, TensorFile};
