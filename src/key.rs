//! A stage's key: the digest of everything that decides its result.
//!
//! One function, [`walk`], goes through all of it, entry by entry, into a [`Sink`]. One sink
//! hashes, the other collects text: so what is hashed and what `explain` prints cannot drift apart.
//! Paths, hosts, threads and log levels are no part of it. Knows nothing of the store.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use artifacts_schema::Digest;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use stages::{Determinism, Source};

use crate::pipeline::graph::Node;
use crate::pipeline::set::variant;

/// The domain of stage keys; a new number when the walk changes.
const DOMAIN: &str = "srnerf-dag stage v1";

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

/// Takes the entries of a recipe in a fixed order.
pub trait Sink {
    /// One entry: what (`params.guidance.lora_every`) and its one text (`3`).
    fn entry(&mut self, path: &str, text: &str);
}

/// Collects entries as text: what is stored beside a result and what `explain` compares.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Manifest(pub BTreeMap<String, String>);

impl Sink for Manifest {
    fn entry(&mut self, path: &str, text: &str) {
        self.0.insert(path.to_owned(), text.to_owned());
    }
}

impl Manifest {
    /// The key that belongs to what it says: its entries, hashed in the order of [`walk`].
    pub fn key(&self) -> Digest {
        let mut entries: Vec<(&String, &String)> = self.0.iter().collect();
        // The map is in the order of its texts, and the key needs that of the walk.
        entries.sort_by_key(|(path, _)| place(path));
        let mut hash = Hash::default();
        entries
            .into_iter()
            .for_each(|(path, text)| hash.entry(path, text));
        hash.digest()
    }
}

/// Where in the walk an entry comes.
fn place(path: &str) -> (usize, Vec<&str>) {
    const ORDER: [&str; 8] = [
        "kind", "version", "seed", "device", "salt", "params", "inputs", "sources",
    ];
    // Compared step by step, as the walk goes: as plain text, `a-b` comes before `a.c`.
    let steps: Vec<&str> = path.split('.').collect();
    (
        ORDER
            .iter()
            .position(|name| *name == steps[0])
            .unwrap_or(ORDER.len()),
        steps,
    )
}

/// Collects entries for hashing, each text behind its length.
#[derive(Default)]
struct Hash(Vec<u8>);

/// Before the first entry: hashing the domain is as much work as a short recipe.
static NOTHING: LazyLock<blake3::Hasher> = LazyLock::new(|| blake3::Hasher::new_derive_key(DOMAIN));

impl Hash {
    fn digest(&self) -> Digest {
        NOTHING.clone().update(&self.0).finalize().into()
    }
}

impl Sink for Hash {
    fn entry(&mut self, path: &str, text: &str) {
        for part in [path, text] {
            // With the lengths, no two lists of entries have the same bytes: `ab`, `c` is not `a`,
            // `bc`.
            self.0.extend_from_slice(&(part.len() as u64).to_le_bytes());
            self.0.extend_from_slice(part.as_bytes());
        }
    }
}

impl Recipe<'_> {
    /// The digest of all entries.
    pub fn key(&self) -> Digest {
        let mut hash = Hash::default();
        walk(self, &mut hash);
        hash.digest()
    }

    /// All entries as text.
    pub fn manifest(&self) -> Manifest {
        let mut manifest = Manifest::default();
        walk(self, &mut manifest);
        manifest
    }
}

/// Goes through everything that decides a result.
pub fn walk(recipe: &Recipe, sink: &mut dyn Sink) {
    let Recipe {
        node,
        inputs,
        sources,
        device,
        salt,
    } = recipe;
    sink.entry("kind", node.stage.kind());
    sink.entry("version", &node.stage.version().to_string());
    sink.entry("seed", &node.seed.to_string());
    // A stage whose bits are the same everywhere has one result for all devices.
    if node.stage.determinism() == Determinism::PerDeviceKind {
        sink.entry(
            "device",
            if node.stage.uses_device() {
                device
            } else {
                "cpu"
            },
        );
    }
    if let Some(salt) = salt {
        sink.entry("salt", salt);
    }
    // An input's field holds the name of a stage, and names are no part of a key: the digest of
    // what it gives is.
    let ports = node.stage.inputs();
    let is_parameter =
        |(name, _): &(&String, &Value)| ports.iter().all(|port| port.name != name.as_str());
    let params: Vec<_> = node
        .params
        .as_object()
        .into_iter()
        .flatten()
        .filter(is_parameter)
        .collect();
    let mut path = Path {
        text: "params".to_owned(),
        locations: node.stage.locations(),
    };
    match params.is_empty() {
        true => sink.entry("params", "{}"),
        false => path.walk_fields(params, sink),
    }
    // A map by name, so the order is the same in every run.
    for (name, digest) in *inputs {
        sink.entry(&format!("inputs.{name}"), &digest.to_string());
    }
    // In the order of the manifest's `place`, not in that in which the stage names them.
    let mut sources: Vec<&Source> = sources.iter().collect();
    sources.sort_by(|a, b| a.name.split('.').cmp(b.name.split('.')));
    for source in sources {
        sink.entry(
            &format!("sources.{}", source.name),
            &source.digest.to_string(),
        );
    }
}
/// The way to a value, and below `params` the ways to where something lies, which are left out.
struct Path<'l> {
    text: String,
    locations: &'l [&'l str],
}

impl Path<'_> {
    /// A value field by field, in the order of the fields' names. A variant's name is an entry, not
    /// a step of the path.
    fn walk(&mut self, value: &Value, sink: &mut dyn Sink) {
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
                sink.entry(&self.text, name);
                self.walk_fields(fields.iter().collect(), sink);
            }
            (Some((name, content)), _) => sink.entry(&self.text, &format!("{name}({content})")),
            (None, Value::Object(fields)) if !fields.is_empty() => {
                self.walk_fields(fields.iter().collect(), sink)
            }
            // Numbers are printed in their shortest form, so that `1e-3` and `0.001` have one key.
            (None, other) => sink.entry(&self.text, &other.to_string()),
        }
    }

    fn walk_fields(&mut self, mut fields: Vec<(&String, &Value)>, sink: &mut dyn Sink) {
        // By name, so that fields can be moved about in the code without changing a key.
        fields.sort_unstable_by_key(|(name, _)| *name);
        let length = self.text.len();
        for (name, value) in fields {
            self.text.push('.');
            self.text.push_str(name);
            self.walk(value, sink);
            self.text.truncate(length);
        }
    }
}

#[cfg(test)]
mod tests;
