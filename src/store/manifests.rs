//! Manifests: what is in each key, kept beside the results for explanations. No result depends on
//! one.

use std::path::PathBuf;

use artifacts_schema::Digest;
use rayon::prelude::*;

use super::error::StoreError;
use super::index::Kind;
use super::signature::Signature;
use super::{Store, json, read_json};
use crate::key::Manifest;

impl Store {
    pub(super) fn manifest_path(&self, key: &Digest) -> PathBuf {
        self.fanned("manifests", key, ".json")
    }

    /// The manifest that belongs to a key, if the stage ever ran here.
    pub fn manifest(&self, key: &Digest) -> Option<Manifest> {
        read_json(&self.manifest_path(key)).ok().flatten()
    }

    /// Keeps the manifest of a key.
    pub fn put_manifest(&self, key: &Digest, manifest: &Manifest) -> Result<(), StoreError> {
        let path = self.manifest_path(key);
        // A key is the digest of its manifest, so what is there can only say the same.
        if path.exists() {
            Ok(())
        } else {
            self.put(&path, &json(&path, manifest)?)
        }
    }

    /// Which of these keys have lost their manifest. While a folder is as it was when all of them
    /// were there, they still are.
    pub fn without_manifest(&self, keys: impl Iterator<Item = Digest>) -> Vec<Digest> {
        let mut keys: Vec<Digest> = keys.collect();
        keys.sort_unstable();
        // The first byte is the name of the folder: one look at a folder spares a look at each
        // manifest in it.
        let folders: Vec<&[Digest]> = keys.chunk_by(|a, b| a.bytes()[0] == b.bytes()[0]).collect();
        folders
            .par_iter()
            .flat_map(|keys| self.missing_in_folder(keys))
            .collect()
    }

    /// The same, of keys whose manifests lie in one folder.
    fn missing_in_folder(&self, keys: &[Digest]) -> Vec<Digest> {
        // The folder is looked at before the files in it, so that one that vanishes in between
        // shows.
        let now = self.clock.now();
        let path = self.manifest_path(&keys[0]);
        let name = name(keys);
        let signature = Signature::at(super::parent(&path));
        let seen: Option<Signature> = self.index.get(Kind::Manifests, &name);
        if seen.is_some() && seen == signature {
            return Vec::new();
        }
        let missing: Vec<Digest> = keys
            .iter()
            .filter(|key| !self.manifest_path(key).exists())
            .copied()
            .collect();
        // Only that all were there is remembered: what is missing will be written soon.
        if let Some(signature) =
            signature.filter(|signature| missing.is_empty() && signature.is_settled(now))
        {
            self.index.put(Kind::Manifests, &name, &signature);
        }
        missing
    }
}

/// The name of a set of keys in the index.
fn name(keys: &[Digest]) -> Digest {
    let mut hasher = blake3::Hasher::new();
    for key in keys {
        hasher.update(key.bytes());
    }
    hasher.finalize().into()
}
