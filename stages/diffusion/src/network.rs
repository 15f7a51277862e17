//! The three networks of a model, and where diffusers keeps each.

/// One network of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Network {
    TextEncoder,
    Unet,
    Vae,
}

impl Network {
    /// All of them, in the order in which a model's digest takes them.
    pub const ALL: [Self; 3] = [Self::TextEncoder, Self::Unet, Self::Vae];

    /// Its folder in the layout of diffusers.
    pub fn folder(self) -> &'static str {
        match self {
            Self::TextEncoder => "text_encoder",
            Self::Unet => "unet",
            Self::Vae => "vae",
        }
    }

    /// The file of its weights in the model's folder, without an ending.
    pub fn stem(self) -> &'static str {
        match self {
            Self::TextEncoder => "text_encoder/model",
            Self::Unet => "unet/diffusion_pytorch_model",
            Self::Vae => "vae/diffusion_pytorch_model",
        }
    }
}
