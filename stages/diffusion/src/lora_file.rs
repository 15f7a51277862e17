//! LoRA files as diffusers, PEFT and kohya's scripts write them: whatever their names look like, one
//! [`LoraNetwork`].
//!
//! Knows names and metadata, not the layers: [`Unet::check_lora`] says whether they fit.

use std::collections::BTreeMap;
use std::path::Path;

use compute::{Array, Device};
use formats::{FileBytes, TensorFile};
use serde_json::{Map, Value};

use crate::error::ModelError;
use crate::kohya::{self, KohyaTensor};
use crate::lora::LoraNetwork;
use crate::stored::array;
use crate::unet::Unet;

/// Where diffusers keeps the adapter's options, and the file in which PEFT does.
const METADATA: &str = "lora_adapter_metadata";
const PEFT_CONFIG: &str = "adapter_config.json";

/// What makes a pattern of PEFT's more than a name. Dots are in names, too.
const SPECIAL: [char; 13] = [
    '\\', '^', '$', '*', '+', '?', '(', ')', '[', ']', '{', '}', '|',
];

/// The prefixes of a UNet's layers: in a pipeline's file, in PEFT's own, and in that of a UNet
/// alone.
// Longer ones first, since they end in shorter ones.
const PREFIXES: [&str; 4] = ["base_model.model.unet.", "base_model.model.", "unet.", ""];

/// The ways to write the two matrices, and the part of the layer's name that they replace.
const MATRICES: [(&str, &str, &str); 8] = [
    (".lora_A.weight", "", "A"),
    (".lora_B.weight", "", "B"),
    // `default` is the adapter's name, which stays in where a model's whole state was saved.
    (".lora_A.default.weight", "", "A"),
    (".lora_B.default.weight", "", "B"),
    (".lora.down.weight", "", "A"),
    (".lora.up.weight", "", "B"),
    // Before diffusers had PEFT, an attention's processor held the LoRA:
    // `attn1.processor.to_q_lora.down`.
    ("_lora.down.weight", ".processor", "A"),
    ("_lora.up.weight", ".processor", "B"),
];

/// A LoRA and the names that its tensors have in their file.
pub struct LoraFile {
    /// The LoRA, without a camera embedding.
    pub network: LoraNetwork,
    /// For each tensor of [`LoraNetwork::adapters`], its name in the file.
    pub names: BTreeMap<String, String>,
}

impl LoraFile {
    /// Reads the LoRA at `path` for `unet`. Fails where a tensor is none of its attentions' or an
    /// option is not supported.
    pub fn read(path: &Path, unet: &Unet, device: &Device) -> Result<Self, ModelError> {
        let file = TensorFile::new(FileBytes::map(path)?)?;
        let mut names = BTreeMap::new();
        let mut adapters = BTreeMap::new();
        let mut alphas = BTreeMap::new();
        // Kohya's names are ambiguous without the network's own: underscores stand for dots.
        let layers = kohya::Layers::new(unet.adapted_layers());
        for stored in file.names() {
            let name = match layers.part(stored) {
                Some(KohyaTensor::Alpha(down)) => {
                    alphas.insert(down, number(&file, stored, device)?);
                    continue;
                }
                Some(KohyaTensor::Matrix(name)) => Some(name),
                None => canonical(stored),
            };
            let name =
                name.ok_or_else(|| file.wrong(stored, "is no LoRA matrix of a UNet's layer"))?;
            adapters.insert(name.clone(), array(&file, stored, device)?);
            if let Some(other) = names.insert(name, stored.to_owned()) {
                return Err(file
                    .wrong(stored, format!("is the same layer's matrix as `{other}`"))
                    .into());
            }
        }
        let mut scales = Options::of(&file, path)?.scales(&adapters);
        // kohya's own alpha beats the metadata: it is this layer's.
        for (down, alpha) in alphas {
            if let Some(rank) = adapters.get(&down).and_then(|down| down.shape().first()) {
                scales.insert(down, alpha / *rank as f32);
            }
        }
        let network = LoraNetwork {
            // Never used: `scales` has an entry for each matrix A.
            scale: 1.0,
            scales,
            adapters,
            camera: BTreeMap::new(),
        };
        unet.check_lora(&network, file.name())?;
        Ok(Self { network, names })
    }
}

/// The only value of a tensor.
fn number(file: &TensorFile, stored: &str, device: &Device) -> Result<f32, ModelError> {
    match array(file, stored, device)?.to_vec()[..] {
        [value] if value.is_finite() => Ok(value),
        _ => Err(file.wrong(stored, "is not one number").into()),
    }
}

/// `unet.<layer>.lora_A.weight` or `..lora_B.weight` for a name in any of the layouts.
fn canonical(stored: &str) -> Option<String> {
    let layer = PREFIXES
        .iter()
        .find_map(|prefix| stored.strip_prefix(prefix))?;
    // The last prefix is empty, so its layers would be taken for the UNet's.
    if layer.starts_with("text_encoder") {
        return None;
    }
    let (layer, (_, dropped, matrix)) = MATRICES
        .iter()
        .find_map(|way| layer.strip_suffix(way.0).map(|layer| (layer, way)))?;
    let mut layer = layer.replacen(dropped, "", usize::from(!dropped.is_empty()));
    // Old attention processors say `to_out_lora`; the layer itself is the first entry of `to_out`.
    if !dropped.is_empty() && layer.ends_with(".to_out") {
        layer.push_str(".0");
    }
    Some(format!("unet.{layer}.lora_{matrix}.weight"))
}

/// What PEFT says of an adapter.
struct Options(Map<String, Value>);

impl Options {
    fn of(file: &TensorFile, path: &Path) -> Result<Self, ModelError> {
        let beside = path.with_file_name(PEFT_CONFIG);
        let parse = |name: &str, text: &[u8]| {
            serde_json::from_slice::<Map<String, Value>>(text)
                .map_err(|e| ModelError::file(name, format!("is not a JSON object: {e}")))
        };
        let fields = match file.metadata().get(METADATA) {
            Some(text) => parse(&format!("{}: {METADATA}", file.name()), text.as_bytes())?,
            None if beside.is_file() => {
                parse(&beside.display().to_string(), &FileBytes::map(&beside)?)?
            }
            None => Map::new(),
        };
        let plain = fields
            .into_iter()
            .map(|(name, value)| (name.trim_start_matches("unet.").to_owned(), value));
        let options = Self(plain.collect());
        // Passed over, each of these would give other numbers than where the file came from,
        // without an error.
        let refused = ["use_dora", "lora_bias", "fan_in_fan_out"]
            .into_iter()
            .find(|name| options.flag(name));
        if let Some(name) = refused {
            return Err(ModelError::field(
                file.name(),
                name,
                "is true; supported is false",
            ));
        }
        // A pattern is matched literally, which is what names of layers mean by themselves.
        if let Some((pattern, _)) = options.alphas().find(|(name, _)| name.contains(SPECIAL)) {
            return Err(ModelError::field(
                file.name(),
                "alpha_pattern",
                format!("holds `{pattern}`; supported are names of layers, no regular expressions"),
            ));
        }
        Ok(options)
    }

    /// The alphas of single layers, by their names or the ends of these.
    fn alphas(&self) -> impl Iterator<Item = (&String, &Value)> {
        let pattern = self.0.get("alpha_pattern").and_then(Value::as_object);
        pattern.into_iter().flatten()
    }

    fn flag(&self, name: &str) -> bool {
        self.0.get(name).and_then(Value::as_bool).unwrap_or(false)
    }

    /// What each product is multiplied by: alpha / r, alpha / sqrt(r) if rank-stabilised, 1 where
    /// nothing is said.
    fn scales(&self, adapters: &BTreeMap<String, Array>) -> BTreeMap<String, f32> {
        let scale = |(name, down): (&String, &Array)| {
            let layer = name.strip_prefix("unet.")?.strip_suffix(".lora_A.weight")?;
            let rank = *down.shape().first()? as f64;
            let divisor = if self.flag("use_rslora") {
                rank.sqrt()
            } else {
                rank
            };
            Some((
                name.clone(),
                self.alpha(layer)
                    .map_or(1.0, |alpha| (alpha / divisor) as f32),
            ))
        };
        adapters.iter().filter_map(scale).collect()
    }

    /// The layer's own alpha, or that of all.
    fn alpha(&self, layer: &str) -> Option<f64> {
        // PEFT lets a pattern match a whole name, or its end behind a dot.
        let ends = |pattern: &str| layer == pattern || layer.ends_with(&format!(".{pattern}"));
        self.alphas()
            .filter(|(pattern, _)| ends(pattern))
            .find_map(|(_, alpha)| alpha.as_f64())
            .or_else(|| self.0.get("lora_alpha")?.as_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_layout_has_the_same_names() {
        let name = "unet.mid_block.attentions.0.transformer_blocks.0.attn1.to_out.0.lora_A.weight";
        for stored in [
            name,
            "mid_block.attentions.0.transformer_blocks.0.attn1.to_out.0.lora_A.weight",
            "mid_block.attentions.0.transformer_blocks.0.attn1.to_out.0.lora_A.default.weight",
            "base_model.model.mid_block.attentions.0.transformer_blocks.0.attn1.to_out.0.lora_A.weight",
            "unet.mid_block.attentions.0.transformer_blocks.0.attn1.to_out.0.lora.down.weight",
            "unet.mid_block.attentions.0.transformer_blocks.0.attn1.processor.to_out_lora.down.weight",
        ] {
            assert_eq!(canonical(stored).as_deref(), Some(name), "{stored}");
        }
        assert_eq!(
            canonical("text_encoder.layers.0.q_proj.lora_A.weight"),
            None
        );
        assert_eq!(
            canonical("unet.mid_block.attn1.to_q.lora_magnitude_vector"),
            None
        );
    }

    #[test]
    fn scales_are_those_of_peft() {
        let scales = |options: Value| {
            let down = Device::cpu().zeros(&[4, 8]);
            let names = ["unet.a.to_q.lora_A.weight", "unet.b.to_q.lora_A.weight"];
            let adapters = names
                .iter()
                .map(|name| (name.to_string(), down.clone()))
                .collect();
            let Value::Object(fields) = options else {
                unreachable!()
            };
            Options(fields)
                .scales(&adapters)
                .into_values()
                .collect::<Vec<_>>()
        };
        assert_eq!(scales(json!({})), [1.0, 1.0]);
        assert_eq!(
            scales(json!({"lora_alpha": 8, "alpha_pattern": {"b.to_q": 2}})),
            [2.0, 0.5]
        );
        assert_eq!(scales(json!({"alpha_pattern": {"b.to_q": 2}})), [1.0, 0.5]);
        assert_eq!(
            scales(json!({"lora_alpha": 8.0, "use_rslora": true})),
            [4.0, 4.0]
        );
    }
}
