//! How kohya's scripts (sd-scripts) name a LoRA's tensors: a layer's path with underscores for dots,
//! and a scalar alpha beside each pair. Knows names, no files.

use std::collections::BTreeMap;

use formats::Tensor;

/// What all tensors of the UNet begin with.
const PREFIX: &str = "lora_unet_";
/// The endings of a layer's three tensors.
const ALPHA: &str = ".alpha";
const DOWN: &str = ".lora_down.weight";
const UP: &str = ".lora_up.weight";

/// The layers of a network by their names in such files.
pub(crate) struct Layers(BTreeMap<String, String>);

/// What a tensor is.
#[derive(Debug, PartialEq)]
pub(crate) enum KohyaTensor {
    /// A matrix, by its name as PEFT has it.
    Matrix(String),
    /// The numerator of a layer's scale, by the name of its matrix A as PEFT has it.
    Alpha(String),
}

impl Layers {
    /// Of these layers; underscores alone do not tell where dots were.
    pub fn new<'a>(layers: impl Iterator<Item = &'a str>) -> Self {
        Self(
            layers
                // Names of layers have underscores of their own, so a flat name is looked up and
                // not taken apart.
                .map(|layer| (flat(layer), layer.to_owned()))
                .collect(),
        )
    }

    /// What the tensor of this name is; `None` if it is none of these layers'.
    pub fn part(&self, stored: &str) -> Option<KohyaTensor> {
        let rest = stored.strip_prefix(PREFIX)?;
        let layer = |suffix: &str| self.0.get(rest.strip_suffix(suffix)?);
        let down = |layer: &String| format!("unet.{layer}.lora_A.weight");
        let up = |layer: &String| format!("unet.{layer}.lora_B.weight");
        let matrix = layer(DOWN).map(down).or_else(|| layer(UP).map(up));
        matrix
            .map(KohyaTensor::Matrix)
            .or_else(|| layer(ALPHA).map(down).map(KohyaTensor::Alpha))
    }
}

fn flat(layer: &str) -> String {
    layer.replace('.', "_")
}

/// The tensors of a LoRA with PEFT's names under kohya's, with `alpha` beside each pair. What is no
/// matrix of a UNet's layer is left out.
pub fn tensors(lora: &BTreeMap<String, Tensor>, alpha: f64) -> BTreeMap<String, Tensor> {
    let mut named = BTreeMap::new();
    for (name, tensor) in lora {
        let Some(rest) = name.strip_prefix("unet.") else {
            continue;
        };
        if let Some(layer) = rest.strip_suffix(".lora_A.weight") {
            // A scalar has no axes, as `torch.tensor(alpha)` in sd-scripts.
            let scale = Tensor {
                shape: Vec::new(),
                values: vec![alpha as f32],
            };
            named.insert(format!("{PREFIX}{}{ALPHA}", flat(layer)), scale);
            named.insert(format!("{PREFIX}{}{DOWN}", flat(layer)), tensor.clone());
        } else if let Some(layer) = rest.strip_suffix(".lora_B.weight") {
            named.insert(format!("{PREFIX}{}{UP}", flat(layer)), tensor.clone());
        }
    }
    named
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYER: &str = "mid_block.attentions.0.transformer_blocks.0.attn1.to_out.0";
    const FLAT: &str = "lora_unet_mid_block_attentions_0_transformer_blocks_0_attn1_to_out_0";

    #[test]
    fn names_go_there_and_back() {
        let name = |matrix| format!("unet.{LAYER}.lora_{matrix}.weight");
        let tensor = |value| Tensor {
            shape: vec![1, 1],
            values: vec![value],
        };
        let lora = BTreeMap::from([(name("A"), tensor(1.0)), (name("B"), tensor(2.0))]);
        let named = tensors(&lora, 4.0);
        let names: Vec<_> = named.keys().map(String::as_str).collect();
        let expected = [ALPHA, DOWN, UP].map(|suffix| format!("{FLAT}{suffix}"));
        assert_eq!(names, expected);
        assert_eq!(named[&expected[0]].values, [4.0]);
        let layers = Layers::new([LAYER].into_iter());
        let parts = expected.map(|stored| layers.part(&stored));
        assert_eq!(
            parts,
            [
                KohyaTensor::Alpha(name("A")),
                KohyaTensor::Matrix(name("A")),
                KohyaTensor::Matrix(name("B"))
            ]
            .map(Some)
        );
    }

    #[test]
    fn other_layers_and_text_encoders_are_none_of_them() {
        let layers = Layers::new([LAYER].into_iter());
        assert_eq!(
            layers.part("lora_unet_mid_block_resnets_0_conv1.alpha"),
            None
        );
        assert_eq!(
            layers.part("lora_te_text_model_encoder_layers_0.alpha"),
            None
        );
        assert_eq!(layers.part(&format!("{FLAT}.dora_scale")), None);
    }
}
