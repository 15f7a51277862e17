//! The latent upscaler: UNet, VAE, text encoder, noise schedule, LoRA and guidance.

pub mod error;

pub use error::ModelError;
