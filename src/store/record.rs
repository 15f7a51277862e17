//! What is kept of a result: its outputs, their files and blobs, and what it took. Knows nothing of
//! the store that it lies in.

use std::collections::BTreeMap;
use std::path::{Component, Path};

use artifacts_schema::{ArtifactKind, Digest};
use serde::{Deserialize, Serialize};

use super::cache::signature::Signature;

/// What a stage produced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The key of the recipe.
    pub key: Digest,
    /// The name of the stage that computed it first.
    pub stage: String,
    /// Its outputs by name.
    pub outputs: BTreeMap<String, Output>,
    /// How long it took.
    pub seconds: f64,
    /// The kind of device that it ran on.
    pub device: String,
    /// What whoever uses it should know, a sentence each.
    #[serde(default)]
    pub remarks: Vec<String>,
    /// The most memory that the program had while it ran, in bytes, where the system tells.
    #[serde(default)]
    pub peak_memory: Option<u64>,
}

/// One output artifact.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// What it is.
    pub kind: ArtifactKind,
    /// The digest of its content, whatever its files say of their origin.
    pub digest: Digest,
    pub files: Vec<StoredFile>,
}

/// A file of an artifact.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredFile {
    /// Its path in the artifact's folder.
    pub path: String,
    /// Its bytes.
    pub blob: Digest,
    /// How many they are.
    pub bytes: u64,
    /// The signature of the blob when this process last found it unchanged.
    #[serde(skip)]
    pub last_signature: LastSignature,
}

/// What a file looked like when it was last looked at, which is no part of what a record says.
#[derive(Clone, Copy, Debug, Default)]
pub struct LastSignature(pub(super) Option<Signature>);

impl PartialEq for LastSignature {
    // Two records that say the same are equal, whenever their files were last looked at.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Record {
    /// Whether this can be the record of a key: it says so, and all its files stay inside their
    /// folders.
    pub fn is_of(&self, key: &Digest) -> bool {
        // Records come from a folder that others can write and from remotes. A path with `..` would
        // let one write outside of the folder where it is shown.
        self.key == *key && self.files().all(|(_, file)| is_inside(&file.path))
    }

    /// All files, with the output that each belongs to.
    pub fn files(&self) -> impl Iterator<Item = (&str, &StoredFile)> {
        self.outputs
            .iter()
            .flat_map(|(name, output)| output.files.iter().map(move |file| (name.as_str(), file)))
    }
}

/// Whether a path stays inside the folder that it is relative to.
pub(super) fn is_inside(path: &str) -> bool {
    !path.is_empty()
        && Path::new(path)
            .components()
            .all(|part| matches!(part, Component::Normal(_)))
}
