//! The text encoder asked about token ids or about a text.

use compute::Device;
use formats::TensorFile;

use super::{Output, Outputs, whole};
use crate::error::ModelError;
use crate::source::ModelSource;
use crate::text_encoder::TextEncoder;
use crate::tokenizer::Tokenizer;

/// The text encoder and what it is asked.
pub(super) struct TextCall {
    encoder: TextEncoder,
    /// N texts of T ids each.
    ids: Vec<Vec<u32>>,
}

impl TextCall {
    pub fn new(
        source: &ModelSource,
        inputs: &TensorFile,
        device: &Device,
    ) -> Result<Self, ModelError> {
        let encoder = TextEncoder::load(source, device)?;
        let config = encoder.config();
        let (shape, ids) = whole(inputs, "input_ids", config.vocab_size as u32)?;
        match shape[..] {
            // Each token has a row in the table of positions, so no text may be longer than it.
            [n, length] if n > 0 && (1..=config.max_position_embeddings).contains(&length) => {
                let ids = ids.chunks(length).map(<[u32]>::to_vec).collect();
                Ok(Self { encoder, ids })
            }
            _ => {
                let most = config.max_position_embeddings;
                Err(inputs
                    .wrong(
                        "input_ids",
                        format!("has the shape {shape:?}; expected [N, 1 to {most}]"),
                    )
                    .into())
            }
        }
    }

    pub fn prompt(source: &ModelSource, prompt: &str, device: &Device) -> Result<Self, ModelError> {
        let encoder = TextEncoder::load(source, device)?;
        let tokenizer = Tokenizer::load(source, encoder.config())?;
        let ids = vec![tokenizer.encode(prompt)];
        Ok(Self { encoder, ids })
    }

    pub fn forward(&self) -> Outputs {
        let shape = vec![self.ids.len(), self.ids.first().map_or(0, Vec::len)];
        let ids = self.ids.concat().into_iter().map(i64::from).collect();
        Outputs::from([
            ("input_ids".into(), Output::Whole(shape, ids)),
            (
                "last_hidden_state".into(),
                Output::Real(self.encoder.forward(&self.ids)),
            ),
        ])
    }
}
