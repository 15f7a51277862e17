//! The latent upscaler: UNet, VAE, text encoder, noise schedule, LoRA and guidance.
//!
//! ```
//! use compute::Device;
//! use diffusion::{ModelSource, Prior};
//!
//! // The small prior that the program carries.
//! let prior = Prior::load(&ModelSource::Embedded, &Device::cpu())?;
//! assert_eq!(prior.unet.config().out_channels, 16);
//! # Ok::<(), diffusion::ModelError>(())
//! ```

pub mod call;
pub mod config;
pub mod error;
pub mod guidance;
pub mod inventory;
pub mod kohya;
mod layers;
pub mod lora;
mod lora_file;
mod network;
pub mod optimize;
pub mod prior;
pub mod schedule;
pub mod single_file;
mod source;
mod stored;
pub mod text_encoder;
pub mod tokenizer;
mod tokenizer_json;
pub mod unet;
pub mod upscaler;
pub mod vae;
mod weights;

pub use error::ModelError;
pub use lora::{LoraGradients, LoraNetwork};
pub use lora_file::LoraFile;
pub use prior::Prior;
pub use source::ModelSource;
pub use stored::array;
pub use unet::Unet;
pub use upscaler::Upscaler;
pub use vae::{Posterior, Vae};
