//! The autoencoder asked about the tensors of a file, one way or the other.

use compute::{Array, Device};
use formats::TensorFile;

use super::{Output, Outputs, real};
use crate::error::ModelError;
use crate::source::ModelSource;
use crate::vae::Vae;

/// The autoencoder and what it is asked.
pub(super) struct VaeCall {
    vae: Vae,
    input: Array,
    encode: bool,
}

impl VaeCall {
    pub fn encode(
        source: &ModelSource,
        inputs: &TensorFile,
        device: &Device,
    ) -> Result<Self, ModelError> {
        let vae = Vae::load(source, device)?;
        let input = real(
            inputs,
            "sample",
            &[None, Some(vae.config().in_channels), None, None],
            device,
        )?;
        // Every halving rounds down, so an image smaller than this would have a latent without
        // pixels.
        if input.shape()[2..]
            .iter()
            .any(|extent| *extent < vae.factor())
        {
            let problem = format!(
                "has the shape {:?}; the least height and width are {}",
                input.shape(),
                vae.factor()
            );
            return Err(inputs.wrong("sample", problem).into());
        }
        Ok(Self {
            vae,
            input,
            encode: true,
        })
    }

    pub fn decode(
        source: &ModelSource,
        inputs: &TensorFile,
        device: &Device,
    ) -> Result<Self, ModelError> {
        let vae = Vae::load(source, device)?;
        let input = real(
            inputs,
            "latent",
            &[None, Some(vae.config().latent_channels), None, None],
            device,
        )?;
        Ok(Self {
            vae,
            input,
            encode: false,
        })
    }

    pub fn forward(&self) -> Outputs {
        if !self.encode {
            return Outputs::from([("sample".into(), Output::Real(self.vae.decode(&self.input)))]);
        }
        let posterior = self.vae.encode(&self.input);
        Outputs::from([
            ("mean".into(), Output::Real(posterior.mean)),
            ("logvar".into(), Output::Real(posterior.logvar)),
        ])
    }
}
