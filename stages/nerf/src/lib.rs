//! The hash-grid radiance field: occupancy, marching, compositing, training, rendering.
//!
//! A [`Field`] lives in unit space ([`Space`]); a [`Trainer`] fits it to [`TrainView`]s; [`render`]
//! makes images of it. Gradients are written out by hand beside each forward pass. Results have the
//! same bits for any number of threads and on any machine: sums have one order, and the kernels use
//! the same fused operations whatever the vector width.
//!
//! [`Training`] and [`Renderer`] do the same on whatever device was chosen; on a GPU the same
//! adapter and driver give the same bits.
//!
//! ```
//! use formats::Camera;
//! use glam::DMat4;
//! use nerf::{Field, FieldConfig, RenderOptions, render};
//!
//! let field = Field::new(&FieldConfig::default(), [[-1.0, -1.0, -3.0], [1.0, 1.0, -1.0]], 7);
//! let camera = Camera::centered((8, 6), 8.0, DMat4::IDENTITY, [1.0, 3.0]);
//! let image = render(&field, &camera, &RenderOptions::default());
//! assert_eq!(image.rgb.len(), 8 * 6 * 3);
//! ```

mod adam;
mod batch;
mod composite;
mod config;
mod contribution;
mod corrections;
mod direction_encoding;
mod exponential;
mod exposure;
mod features;
mod field;
mod gpu;
mod kernels;
mod localize;
mod loss;
mod march;
mod mask;
mod network;
mod occupancy;
mod occupancy_update;
mod options;
mod perspective;
mod point_query;
mod pool;
mod poses;
mod positions;
mod ray_termination;
mod render;
mod samples;
mod space;
mod spherical;
mod state;
mod tensors;
mod train;
mod train_pixels;
mod training;
mod view_parameters;
mod volume_rendering;

pub use batch::TrainView;
pub use config::{FieldConfig, Level};
pub use exposure::{Exposure, ExposureOptions, WHITE};
pub use field::Field;
pub use gpu::{Check, GpuTrainer, Renderer, Work, check};
pub use localize::localize;
pub use march::Segment;
pub use mask::Mask;
pub use options::TrainOptions;
pub use point_query::OccupancyCounts;
pub use poses::PoseOptions;
pub use render::{RenderOptions, Rendered, render};
pub use space::{Space, SpaceKind};
pub use tensors::{FieldError, Tensors};
pub use train::{StepStats, Trainer};
pub use train_pixels::{PixelFile, StoredPixels, TrainPixels};
pub use training::Training;
