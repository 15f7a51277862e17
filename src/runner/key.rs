//! A stage's key: the digest of everything that decides its result.
//!
//! All of it is first written down as text, entry by entry: the [`Manifest`]. That is hashed, and
//! that is what `explain` prints, so that the two cannot drift apart. Paths, hosts, threads and log
//! levels are no part of it. Knows nothing of the store.

use std::collections::BTreeMap;

use artifacts_schema::Digest;
use serde_json::Value;
use stages::{Determinism, Source};

use crate::pipeline::graph::Node;
use crate::pipeline::set::variant;
use crate::store::manifest::Manifest;

/// Everything that decides a stage's result.
pub struct Recipe<'a> {
    /// The stage, its parameters and its seed.
    pub node: &'a Node,
    /// The semantic digests of its inputs, by input name.
    pub inputs: &'a BTreeMap<String, Digest>,
    /// What it reads beside them.
    pub sources: &'a [Source],
    /// The kind of device that was chosen; only some stages compute on it.
    pub device: &'a str,
    /// The user's own word, which sets a whole set of results apart.
    pub salt: Option<&'a str>,
}

impl Recipe<'_> {
    /// The digest of all entries.
    pub fn key(&self) -> Digest {
        self.manifest().key()
    }

    /// All entries.
    pub fn manifest(&self) -> Manifest {
        let mut manifest = Manifest::default();
        walk(self, &mut manifest);
        manifest
    }
}

/// Writes down everything that decides a result.
fn walk(recipe: &Recipe, manifest: &mut Manifest) {
    let stage = &recipe.node.stage;
    manifest.enter("kind", stage.kind());
    manifest.enter("version", stage.version());
    manifest.enter("seed", recipe.node.seed);
    // A stage whose bits are the same everywhere has one result for all devices.
    if stage.determinism() == Determinism::PerDeviceKind {
        let device = if stage.uses_device() {
            recipe.device
        } else {
            "cpu"
        };
        manifest.enter("device", device);
    }
    if let Some(salt) = recipe.salt {
        manifest.enter("salt", salt);
    }
    walk_params(recipe.node, manifest);
    for (name, digest) in recipe.inputs {
        manifest.enter(&format!("inputs.{name}"), digest);
    }
    for Source { name, digest } in recipe.sources {
        manifest.enter(&format!("sources.{name}"), digest);
    }
}

fn walk_params(node: &Node, manifest: &mut Manifest) {
    // An input's field holds the name of a stage, and names are no part of a key: the digest of
    // what it gives is.
    let ports = node.stage.inputs();
    let is_parameter =
        |(name, _): &(&String, &Value)| ports.iter().all(|port| port.name != name.as_str());
    let fields = node.params.as_object().into_iter().flatten();
    let mut params = fields.filter(is_parameter).peekable();
    let mut path = Path {
        text: "params".to_owned(),
        locations: node.stage.locations(),
    };
    match params.peek() {
        None => manifest.enter("params", "{}"),
        Some(_) => path.walk_fields(params, manifest),
    }
}

/// The way to a value, and below `params` the ways to where something lies, which are left out.
struct Path<'l> {
    text: String,
    locations: &'l [&'l str],
}

impl Path<'_> {
    /// A value field by field. A variant's name is an entry, not a step of the path.
    fn walk(&mut self, value: &Value, manifest: &mut Manifest) {
        // Where photos lie does not matter, only what they are: their digests are among the
        // sources.
        if self
            .text
            .strip_prefix("params.")
            .is_some_and(|path| self.locations.contains(&path))
        {
            return;
        }
        match (variant(value), value) {
            (Some((name, Value::Object(fields))), _) => {
                manifest.enter(&self.text, name);
                self.walk_fields(fields, manifest);
            }
            (Some((name, content)), _) => manifest.enter(&self.text, format!("{name}({content})")),
            (None, Value::Object(fields)) if !fields.is_empty() => {
                self.walk_fields(fields, manifest)
            }
            // Numbers are printed in their shortest form, so that `1e-3` and `0.001` have one key.
            (None, other) => manifest.enter(&self.text, other),
        }
    }

    fn walk_fields<'v>(
        &mut self,
        fields: impl IntoIterator<Item = (&'v String, &'v Value)>,
        manifest: &mut Manifest,
    ) {
        let length = self.text.len();
        for (name, value) in fields {
            self.text.push('.');
            self.text.push_str(name);
            self.walk(value, manifest);
            self.text.truncate(length);
        }
    }
}

#[cfg(test)]
mod tests;
