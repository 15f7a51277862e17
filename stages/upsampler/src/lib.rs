//! Feed-forward networks that enlarge images: ours, Real-ESRGAN's RRDBNet, SRVGGNetCompact and
//! SPAN.
//!
//! Reads what people have of them, safetensors and ncnn's pairs of files, and tells a network by
//! its tensors' names and shapes, or by its graph. Runs on the operators of `compute`, so on the
//! CPU and on GPUs. Knows nothing of colour spaces, cameras and pipelines: it takes and gives
//! numbers from 0 to 1.
//!
//! ```
//! use compute::Device;
//! use upsampler::{Options, Upsampler, UpsamplerSource};
//!
//! let device = Device::cpu();
//! let network = Upsampler::load(&UpsamplerSource::Embedded, &device)?;
//! let small = device.array(&[1, 3, 8, 8], vec![0.5; 3 * 8 * 8]);
//! let large = network.enlarge(&small, Options::default());
//! assert_eq!(large.shape(), [1, 3, 32, 32]);
//! # Ok::<(), upsampler::UpsamplerError>(())
//! ```

mod compact;
mod convolution;
mod ensemble;
mod error;
mod family;
mod ncnn;
mod network;
mod residual;
mod rrdb;
mod source;
mod span;
mod tensors;
mod tiles;
mod upsampler;

pub use error::UpsamplerError;
pub use source::{EMBEDDED_NAME, UpsamplerSource};
pub use upsampler::{Inventory, Options, Upsampler};
