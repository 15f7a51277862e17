//! A radiance field: its hash tables, networks and occupancy grid as tensors of one safetensors
//! file. Knows not what they mean.

use std::collections::BTreeMap;
use std::path::Path;

use formats::{Bounds, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::artifact::{Artifact, ArtifactKind};
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::provenance::Provenance;
use crate::tensors::{self, METADATA_KEY};

const FILE: &str = "field.safetensors";

/// A radiance field as it lies on disk: a configuration and tensors, whose meaning the field's
/// library knows.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Its architecture, as the field's own library writes it.
    pub config: Value,
    /// Its tensors by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// The scene box: its lower and its upper corner.
    pub bounds: Bounds,
}

/// The JSON in the file's metadata.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub(crate) struct FieldMetadata {
    config: Value,
    bounds: Bounds,
    provenance: Provenance,
}

impl Artifact for Field {
    const KIND: ArtifactKind = ArtifactKind::Field;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        // Before a file is touched: JSON would write null for what is not finite.
        canonical::check_bounds(&self.bounds)?;
        let metadata = FieldMetadata {
            config: self.config.clone(),
            bounds: self.bounds,
            provenance: provenance.clone(),
        };
        let metadata = BTreeMap::from([
            // Loaders of Hugging Face's libraries look for this key.
            ("format", "pt".to_owned()),
            (METADATA_KEY, canonical::line(&metadata)?),
        ]);
        tensors::write(folder, FILE, tensors::by_name(&self.tensors), &metadata)
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        let file = tensors::open(&folder.join(FILE))?;
        let FieldMetadata { config, bounds, .. } = tensors::header(&file)?;
        Ok(Self {
            config,
            tensors: tensors::all(&file)?,
            bounds,
        })
    }

    fn semantic_digest(&self) -> Digest {
        let mut hasher = ContentHasher::new(Self::KIND);
        hasher.json(&self.config);
        hasher.bounds(&self.bounds);
        hasher.tensors(self.tensors.iter());
        hasher.finish()
    }
}
