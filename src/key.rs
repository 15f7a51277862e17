//! A stage's key: the digest of everything that decides its result.
//!
//! One function, [`walk`], goes through all of it, entry by entry, into a [`Sink`]. One sink hashes, the other collects text:
//! so what is hashed and what `explain` prints cannot drift apart. Paths, hosts, threads and log levels are no part of it.
//! Knows nothing of the store.

use std::collections::BTreeMap;

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
    pub inputs: &'a BTreeMap<&'static str, Digest>,
    /// What it reads beside them.
    pub sources: &'a [Source],
    /// The kind of device that it computes on.
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

/// Hashes entries, each text behind its length.
struct Hash(blake3::Hasher);

impl Sink for Hash {
    fn entry(&mut self, path: &str, text: &str) {
        for part in [path, text] {
            self.0.update(&(part.len() as u64).to_le_bytes()).update(part.as_bytes());
        }
    }
}

impl Recipe<'_> {
    /// The digest of all entries.
    pub fn key(&self) -> Digest {
        let mut hash = Hash(blake3::Hasher::new_derive_key(DOMAIN));
        walk(self, &mut hash);
        hash.0.finalize().into()
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
    let Recipe { node, inputs, sources, device, salt } = recipe;
    sink.entry("kind", node.stage.kind());
    sink.entry("version", &node.stage.version().to_string());
    sink.entry("seed", &node.seed.to_string());
    if node.stage.determinism() == Determinism::PerDeviceKind {
        sink.entry("device", device);
    }
    if let Some(salt) = salt {
        sink.entry("salt", salt);
    }
    let mut params = node.params.clone();
    if let Some(fields) = params.as_object_mut() {
        node.stage.inputs().iter().for_each(|port| drop(fields.remove(port.name)));
    }
    let locations: Vec<String> = node.stage.locations().iter().map(|location| format!("params.{location}")).collect();
    walk_value("params", &params, &locations, sink);
    for (name, digest) in *inputs {
        sink.entry(&format!("inputs.{name}"), &digest.to_string());
    }
    for source in *sources {
        sink.entry(&format!("sources.{}", source.name), &source.digest.to_string());
    }
}

/// A value field by field, in the order of the fields' names. A variant's name is an entry, not a step of the path.
fn walk_value(path: &str, value: &Value, locations: &[String], sink: &mut dyn Sink) {
    if locations.iter().any(|location| location == path) {
        return;
    }
    match (variant(value), value) {
        (Some((name, Value::Object(fields))), _) => {
            sink.entry(path, name);
            walk_fields(path, fields, locations, sink);
        }
        (Some((name, content)), _) => sink.entry(path, &format!("{name}({content})")),
        (None, Value::Object(fields)) if !fields.is_empty() => walk_fields(path, fields, locations, sink),
        (None, other) => sink.entry(path, &other.to_string()),
    }
}

fn walk_fields(path: &str, fields: &serde_json::Map<String, Value>, locations: &[String], sink: &mut dyn Sink) {
    let sorted: BTreeMap<&String, &Value> = fields.iter().collect();
    for (name, value) in sorted {
        walk_value(&format!("{path}.{name}"), value, locations, sink);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;
    use stages::registry::AnyStage;

    use super::*;
    use crate::pipeline::text::Tree;
    use crate::testing::sum;

    fn recipe_of(node: &Node, check: impl Fn(&Recipe)) {
        check(&Recipe { node, inputs: &BTreeMap::new(), sources: &[], device: "cpu", salt: None });
    }

    /// The key of an `Optimize` stage with these parameters in RON.
    fn key_of(fields: &str) -> Digest {
        let params = Tree::read(fields).unwrap().json();
        let stage = AnyStage::from_parameters("Optimize", params).unwrap();
        let params = stage.parameters().unwrap();
        let node = Node { name: "x".into(), seed: 0, stage: stage.into_stage(), params, wires: Vec::new() };
        Recipe { node: &node, inputs: &BTreeMap::new(), sources: &[], device: "cpu", salt: None }.key()
    }

    #[test]
    fn the_manifest_is_what_is_hashed() {
        let (node, _) = sum("s", 1, &[]);
        recipe_of(&node, |recipe| {
            let mut hash = Hash(blake3::Hasher::new_derive_key(DOMAIN));
            let Manifest(entries) = recipe.manifest();
            let order = ["kind", "version", "seed", "device", "params.modulo", "params.number"];
            assert_eq!(entries.len(), order.len());
            order.iter().for_each(|path| hash.entry(path, &entries[*path]));
            assert_eq!(Digest::from(hash.0.finalize()), recipe.key());
        });
    }

    #[test]
    fn one_value_has_one_text() {
        let key = key_of("(steps: 100, guidance: Vsd(lora_every: 3))");
        assert_eq!(key, key_of("(guidance: Vsd(lora_every: 0x3,),\n /* first */ steps: 1_00)"));
        assert_ne!(key, key_of("(steps: 101, guidance: Vsd(lora_every: 3))"));
        assert_ne!(key, key_of("(steps: 100, guidance: Vsd(lora_every: 1))"));
        assert_ne!(key, key_of("(steps: 100, guidance: Rsd())"));
    }

    #[test]
    fn names_of_inputs_and_stages_are_no_part_of_a_key_but_digests_are() {
        let params = |from: &str| json!({"images": from});
        let node = |from: &str| {
            let stage = AnyStage::from_parameters("Fit", params(from)).unwrap();
            let params = stage.parameters().unwrap();
            Node { name: from.into(), seed: 0, stage: stage.into_stage(), params, wires: Vec::new() }
        };
        let (a, b) = (node("a"), node("b"));
        let inputs = |text: &str| BTreeMap::from([("images", Digest::from(blake3::hash(text.as_bytes())))]);
        let (one, two) = (inputs("1"), inputs("2"));
        let key = |node, inputs, salt| Recipe { node, inputs, sources: &[], device: "cpu", salt }.key();
        assert_eq!(key(&a, &one, None), key(&b, &one, None));
        assert_ne!(key(&a, &one, None), key(&a, &two, None));
        assert_ne!(key(&a, &one, None), key(&a, &one, Some("s")));
    }

    /// Numbers in spellings that mean the same.
    fn spellings(number: f64) -> [String; 3] {
        [format!("{number:?}"), format!("{number:e}"), format!("+{number:?}")]
    }

    proptest! {
        #[test]
        fn equal_numbers_give_equal_keys(number in 1e-6f64..1e6) {
            let key = |text: &str| {
                let (mut node, _) = sum("s", 1, &[]);
                node.params = json!({"rate": Tree::read(text).unwrap().json().as_f64()});
                Recipe { node: &node, inputs: &BTreeMap::new(), sources: &[], device: "cpu", salt: None }.key()
            };
            let [plain, power, plus] = spellings(number);
            prop_assert_eq!(key(&plain), key(&power));
            prop_assert_eq!(key(&plain), key(&plus));
            prop_assert_ne!(key(&plain), key(&format!("{:?}", f64::from_bits(number.to_bits() + 1))));
        }

        #[test]
        fn different_params_give_different_keys(a in params(), b in params()) {
            let key = |params: &Value| {
                let (mut node, _) = sum("s", 1, &[]);
                node.params = params.clone();
                Recipe { node: &node, inputs: &BTreeMap::new(), sources: &[], device: "cpu", salt: None }.key()
            };
            prop_assert_eq!(a == b, key(&a) == key(&b));
        }
    }

    /// Parameters as stages have them: numbers, texts, lists, variants, nested structs.
    fn params() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::from),
            (0u8..4).prop_map(Value::from),
            "[a-c.]{0,2}".prop_map(Value::from),
            "[A-B]{1}".prop_map(Value::from),
        ];
        let nested = leaf.prop_recursive(3, 12, 3, |inner| {
            prop_oneof![
                prop::collection::vec(inner.clone(), 0..3).prop_map(Value::from),
                prop::collection::btree_map("[a-b]{1,2}", inner.clone(), 0..3).prop_map(|fields| json!(fields)),
                ("[A-B]{1}", inner).prop_map(|(name, content)| json!({ name: content })),
            ]
        });
        prop::collection::btree_map("[a-c]", nested, 0..4).prop_map(|fields| json!(fields))
    }
}
