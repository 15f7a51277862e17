//! Readers of posed photos, procedural scenes, and layouts of other programs.
//!
//! Everything here follows `docs/conventions.md`: OpenGL axes, pixel centres at +0.5, sRGB-encoded
//! photos, depth along the view axis. Readers bring foreign conventions into these at the door;
//! nothing behind them knows others.
//!
//! ```
//! // A drawn scene: four views of 16x12 pixels, one ray each.
//! let drawn = scene::still_life(4, (16, 12), 1, 0);
//! assert_eq!(drawn.photos.len(), 4);
//! assert_eq!(drawn.photos[0].pixels.rgb.len(), 16 * 12 * 3);
//! ```

mod colmap;
mod downscale;
mod error;
mod faults;
mod finder;
mod folders;
mod gathering;
mod layouts;
mod llff;
mod mask;
mod normalize;
mod parsed;
mod path;
mod photo;
mod photo_file;
mod picture;
mod plausible;
mod pose;
mod procedural;
mod reader;
mod source_files;
mod transforms;

pub use colmap::{Colmap, Registered};
pub use downscale::{Reducer, downscale};
pub use error::SceneError;
pub use layouts::{Capture, Layout, LayoutError, Part, Point};
pub use llff::Llff;
pub use parsed::{ParsedScene, decoding_memory};
pub use path::{circle, path_digest, path_from_file, path_text, spiral, upwards};
pub use photo::{Photo, SceneData, split_holdout};
pub use pose::{focus, rigid};
pub use procedural::{object, object_tests, still_life};
pub use reader::Reader;
pub use transforms::{Transforms, write_transforms};
