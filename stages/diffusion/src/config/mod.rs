//! The networks' configurations as diffusers and transformers write them, with the same defaults.
//!
//! An option that the networks here do not have is refused by name. Knows no weights and no
//! arithmetic.

mod check;
mod text;
mod unet;
mod vae;

use formats::FileBytes;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use crate::error::ModelError;

pub use text::{TextActivation, TextConfig};
pub use unet::{UnetBlock, UnetConfig};
pub use vae::VaeConfig;

/// One value for all blocks, or one for each, from the first down block on.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub enum PerBlock<T> {
    /// One value that holds for all blocks.
    Same(T),
    /// One value for each block, from the first down block on.
    Each(Vec<T>),
}

impl<T: Copy> PerBlock<T> {
    /// The value of block `index`.
    pub fn of(&self, index: usize) -> T {
        match self {
            Self::Same(value) => *value,
            Self::Each(values) => values[index],
        }
    }

    pub(super) fn all(&self) -> &[T] {
        match self {
            Self::Same(value) => std::slice::from_ref(value),
            Self::Each(values) => values,
        }
    }
}

impl<T> PerBlock<T> {
    pub(super) fn count(&self, blocks: usize) -> usize {
        match self {
            Self::Same(_) => blocks,
            Self::Each(values) => values.len(),
        }
    }
}

/// Reads a configuration. Fields of `fixed` must have the value given there (or be absent); fields
/// of `idle` and those that begin with an underscore may have any.
pub(crate) fn parse<T: DeserializeOwned>(
    file: &FileBytes,
    fixed: &Value,
    idle: &[&str],
) -> Result<T, ModelError> {
    let mut fields: Map<String, Value> = serde_json::from_slice(file)
        .map_err(|e| ModelError::file(file.name(), format!("is not a JSON object: {e}")))?;
    // Underscores mark what diffusers notes about the file, such as `_class_name` and
    // `_diffusers_version`.
    fields.retain(|name, _| !name.starts_with('_') && !idle.contains(&name.as_str()));
    for (name, supported) in fixed.as_object().into_iter().flatten() {
        // Taken out, since UNet and autoencoder refuse fields that their types do not know.
        match fields.remove(name) {
            Some(value) if !same(&value, supported) => {
                return Err(ModelError::field(
                    file.name(),
                    name,
                    format!("is {value}; supported is {supported}"),
                ));
            }
            _ => {}
        }
    }
    // Plain serde would tell the problem without the field it is in.
    serde_path_to_error::deserialize(Value::Object(fields)).map_err(|e| {
        ModelError::field(
            file.name(),
            e.path().to_string(),
            format!("cannot be used: {}", e.inner()),
        )
    })
}

/// Equal, where 1 and 1.0 are, and an absent value may be written as null.
fn same(value: &Value, supported: &Value) -> bool {
    value.is_null()
        || value == supported
        || value
            .as_f64()
            .is_some_and(|v| Some(v) == supported.as_f64())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::ModelSource;

    fn with_file<T>(
        text: &str,
        read: impl Fn(&FileBytes) -> Result<T, ModelError>,
    ) -> Result<T, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("config.json"), text).unwrap();
        let file = ModelSource::Folder(folder.path().to_owned())
            .file("config.json")
            .unwrap();
        read(&file).map_err(|e| {
            e.to_string()
                .rsplit_once("config.json: ")
                .unwrap()
                .1
                .to_owned()
        })
    }

    fn refusal(text: &str) -> String {
        with_file(text, UnetConfig::read).unwrap_err()
    }

    #[test]
    fn what_the_networks_do_not_have_is_refused_by_name() {
        assert_eq!(
            refusal(r#"{"act_fn": "mish"}"#),
            r#"`act_fn` is "mish"; supported is "silu""#
        );
        assert_eq!(
            refusal(r#"{"mid_block_scale_factor": 1.5}"#),
            "`mid_block_scale_factor` is 1.5; supported is 1"
        );
        let block = refusal(r#"{"down_block_types": ["DownBlock2D", "AttnDownBlock2D"]}"#);
        assert!(
            block.starts_with(
                "`down_block_types[1]` cannot be used: unknown variant `AttnDownBlock2D`"
            ),
            "{block}"
        );
        let unknown = refusal(r#"{"hyper_network": 3}"#);
        assert!(
            unknown.contains("unknown field `hyper_network`"),
            "{unknown}"
        );
        let encoder = with_file(
            r#"{"down_block_types": ["AttnDownEncoderBlock2D"]}"#,
            VaeConfig::read,
        )
        .unwrap_err();
        assert!(
            encoder.starts_with("`down_block_types[0]` cannot be used: unknown variant"),
            "{encoder}"
        );
        let text = with_file(r#"{"hidden_act": "relu"}"#, TextConfig::read).unwrap_err();
        assert!(
            text.starts_with("`hidden_act` cannot be used: unknown variant `relu`"),
            "{text}"
        );
    }

    #[test]
    fn what_does_not_fit_together_is_refused_by_name() {
        assert_eq!(
            refusal("[]").split(':').next(),
            Some("is not a JSON object")
        );
        assert_eq!(
            refusal(r#"{"block_out_channels": [320, 640]}"#),
            "`down_block_types` has 4 entries; `block_out_channels` has 2"
        );
        assert_eq!(
            refusal(r#"{"norm_num_groups": 7}"#),
            "`norm_num_groups` is 7, which does not divide 320"
        );
        assert_eq!(
            refusal(r#"{"attention_head_dim": [8, 8, 8, 0]}"#),
            "`attention_head_dim` is 0; it must be from 1 to 65536"
        );
        assert_eq!(
            refusal(r#"{"in_channels": 99999999}"#),
            "`in_channels` is 99999999; it must be from 1 to 65536"
        );
        assert_eq!(
            refusal(r#"{"cross_attention_dim": [1024, 1024, 512, 1024]}"#),
            "`cross_attention_dim` is 1024 and 512; one text goes to all blocks"
        );
        assert_eq!(
            refusal(r#"{"freq_shift": 160}"#),
            "`freq_shift` is half of the first block's channels"
        );
    }

    #[test]
    fn defaults_and_the_ways_to_write_a_value_are_those_of_diffusers() {
        let text = r#"{"_class_name": "x", "mid_block_scale_factor": 1.0, "upcast_attention": null, "num_class_embeds": null,
            "layers_per_block": [1, 2, 3, 4], "encoder_hid_dim": null, "sample_size": 128}"#;
        let config = with_file(text, UnetConfig::read).unwrap();
        assert_eq!(
            (
                config.layers_per_block.of(2),
                config.attention_head_dim.of(2)
            ),
            (3, 8)
        );
        assert_eq!(config.block_out_channels, [320, 640, 1280, 1280]);
    }
}
