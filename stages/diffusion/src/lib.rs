//! The latent upscaler: UNet, VAE, text encoder, noise schedule, LoRA and guidance.
