//! Manifests: what is in each key, kept beside the results for explanations. No result depends on
//! one.

use std::path::PathBuf;
use std::sync::Arc;

use artifacts_schema::Digest;
use rayon::prelude::*;

use super::cache::Cache;
use super::cache::index::Kind;
use super::cache::signature::Signature;
use super::error::StoreError;
use super::files::{Files, json, parent, read_json};
use super::listing::{Entry, list};
use crate::store::manifest::Manifest;

/// The manifests of a store.
pub struct Manifests {
    files: Arc<Files>,
    cache: Arc<Cache>,
}

impl Manifests {
    pub(super) fn new(files: Arc<Files>, cache: Arc<Cache>) -> Self {
        Self { files, cache }
    }

    /// Where the manifest of a key lies.
    pub(super) fn path(&self, key: &Digest) -> PathBuf {
        self.files.fanned("manifests", key, ".json")
    }

    /// The manifest that belongs to a key, if the stage ever ran here.
    pub fn get(&self, key: &Digest) -> Option<Manifest> {
        read_json(&self.path(key)).ok().flatten()
    }

    /// Keeps the manifest of a key.
    pub fn put(&self, key: &Digest, manifest: &Manifest) -> Result<(), StoreError> {
        let path = self.path(key);
        // A key is the digest of its manifest, so what is there can only say the same.
        if path.exists() {
            Ok(())
        } else {
            self.files.put(&path, &json(&path, manifest)?)
        }
    }

    /// The keys with a manifest that begin with these digits, at least six.
    pub fn keys_like(&self, beginning: &str) -> Result<Vec<Digest>, StoreError> {
        // Fewer digits would often fit several keys, and the first two name the folder.
        if beginning.len() < 6 || !beginning.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Ok(Vec::new());
        }
        let folder = list(&self.files.root.join("manifests").join(&beginning[..2]))?;
        let keys = folder.iter().filter_map(Entry::digest);
        Ok(keys
            .filter(|key| key.to_string().starts_with(beginning))
            .collect())
    }

    /// Which of these keys have lost their manifest. While a folder is as it was when all of them
    /// were there, they still are.
    pub fn missing(&self, keys: impl Iterator<Item = Digest>) -> Vec<Digest> {
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
        let now = self.cache.clock.now();
        let path = self.path(&keys[0]);
        let name = name(keys);
        let signature = Signature::at(parent(&path));
        let seen: Option<Signature> = self.cache.index.get(Kind::Manifests, &name);
        if seen.is_some() && seen == signature {
            return Vec::new();
        }
        let missing: Vec<Digest> = keys
            .iter()
            .filter(|key| !self.path(key).exists())
            .copied()
            .collect();
        // Only that all were there is remembered: what is missing will be written soon.
        if let Some(signature) =
            signature.filter(|signature| missing.is_empty() && signature.is_settled(now))
        {
            self.cache.index.put(Kind::Manifests, &name, &signature);
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
