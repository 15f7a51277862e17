//! Low-rank weights in the diffusers/PEFT layout, and beside them the camera embedding, which that
//! layout has no place for.
//!
//! The paper writes W + AB; its A is `lora_B` here (up), its B is `lora_A` (down).

use std::collections::BTreeMap;
use std::path::Path;

use formats::Tensor;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::artifact::{Artifact, ArtifactKind};
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::provenance::Provenance;
use crate::tensors::{self, METADATA_KEY};

const WEIGHTS_FILE: &str = "pytorch_lora_weights.safetensors";
const CAMERA_FILE: &str = "camera_embedding.safetensors";

/// Low-rank weights of a UNet: W + (alpha / rank) up · down at each adapted layer.
#[derive(Clone, Debug, PartialEq)]
pub struct Lora {
    /// The rank of every pair.
    pub rank: usize,
    /// The numerator of the scale.
    pub alpha: f64,
    /// `unet.<module path>.lora_A.weight` (down: rank x in) and `unet.<module path>.lora_B.weight`
    /// (up: out x rank).
    pub tensors: BTreeMap<String, Tensor>,
    /// The layers that embed the camera, by name; empty if there are none.
    pub camera: BTreeMap<String, Tensor>,
}

/// The JSON in both files' metadata.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub(crate) struct LoraMetadata {
    rank: usize,
    alpha: f64,
    provenance: Provenance,
}

impl Lora {
    fn check(&self) -> Result<(), SchemaError> {
        if !self.alpha.is_finite() {
            return Err(SchemaError::content(
                "alpha",
                format!("is {}; expected a number", self.alpha),
            ));
        }
        self.tensors
            .iter()
            .try_for_each(|(name, tensor)| check_tensor(name, tensor, self.rank))?;
        // Both lists are sorted by module, since the map is; so pairs stand at equal places.
        match self
            .modules(".lora_A.weight")
            .eq(self.modules(".lora_B.weight"))
        {
            true => Ok(()),
            false => Err(SchemaError::content(
                "tensors",
                "lora_A and lora_B do not come in pairs",
            )),
        }
    }

    /// The adapted layers: the names of the tensors with this suffix, without it.
    fn modules<'a>(&'a self, suffix: &'a str) -> impl Iterator<Item = &'a str> {
        self.tensors
            .keys()
            .filter_map(move |name| name.strip_prefix("unet.")?.strip_suffix(suffix))
    }

    /// What PEFT wants to know of the adapter, as diffusers stores it.
    fn adapter_metadata(&self) -> Value {
        json!({
            "unet.bias": "none",
            // The names under which diffusers hands it to PEFT; without them alpha would be taken
            // for the rank.
            "unet.lora_alpha": self.alpha,
            "unet.peft_type": "LORA",
            "unet.r": self.rank,
            "unet.target_modules": self.modules(".lora_A.weight").collect::<Vec<_>>(),
        })
    }
}

/// Refuses tensors that diffusers would not load.
fn check_tensor(name: &str, tensor: &Tensor, rank: usize) -> Result<(), SchemaError> {
    let module = name.strip_prefix("unet.").unwrap_or_default();
    let fits = match tensor.shape[..] {
        // Rows are outputs and columns inputs, as in PyTorch's linear layers.
        [down, _] if module.ends_with(".lora_A.weight") => down == rank,
        [_, up] if module.ends_with(".lora_B.weight") => up == rank,
        _ => false,
    };
    if fits {
        return Ok(());
    }
    let expected =
        format!("expected unet.*.lora_A.weight [{rank}, in] or unet.*.lora_B.weight [out, {rank}]");
    Err(SchemaError::content(
        format!("tensor {name:?}"),
        format!("has shape {:?}; {expected}", tensor.shape),
    ))
}

impl Artifact for Lora {
    const KIND: ArtifactKind = ArtifactKind::Lora;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        self.check()?;
        let ours = LoraMetadata {
            rank: self.rank,
            alpha: self.alpha,
            provenance: provenance.clone(),
        };
        let mut metadata = BTreeMap::from([
            ("format", "pt".to_owned()),
            (METADATA_KEY, canonical::line(&ours)?),
        ]);
        // Always, even when empty: a missing file would be a damaged artifact.
        tensors::write(
            folder,
            CAMERA_FILE,
            tensors::by_name(&self.camera),
            &metadata,
        )?;
        // After the camera's file, which diffusers does not read.
        metadata.insert(
            "lora_adapter_metadata",
            format!("{:#}", canonical::value(&self.adapter_metadata())?),
        );
        tensors::write(
            folder,
            WEIGHTS_FILE,
            tensors::by_name(&self.tensors),
            &metadata,
        )
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        let path = folder.join(WEIGHTS_FILE);
        let weights = tensors::open(&path)?;
        let LoraMetadata { rank, alpha, .. } = tensors::header(&weights)?;
        let camera = tensors::open(&folder.join(CAMERA_FILE))?;
        let lora = Self {
            rank,
            alpha,
            tensors: tensors::all(&weights)?,
            camera: tensors::all(&camera)?,
        };
        // The same checks both ways: what diffusers could not load is refused here.
        lora.check().map_err(|error| error.in_file(&path))?;
        Ok(lora)
    }

    fn semantic_digest(&self) -> Digest {
        let mut hasher = ContentHasher::new(Self::KIND);
        hasher.count(self.rank);
        hasher.real(self.alpha);
        hasher.tensors(self.tensors.iter());
        hasher.tensors(self.camera.iter());
        hasher.finish()
    }
}
