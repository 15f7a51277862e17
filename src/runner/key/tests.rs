//! Keys: what is one recipe has one key however it is written, and what is another has another.

use proptest::prelude::*;
use serde_json::json;
use stages::registry::{AnyStage, KINDS};

use super::*;
use crate::pipeline::text::Tree;
use crate::pipeline::unroll::round_seed;
use crate::runner::testing::sum;

/// A stage without inputs.
fn node_of(kind: &str, params: Value) -> Node {
    let stage = AnyStage::from_parameters(kind, params).unwrap();
    let params = stage.parameters().unwrap();
    Node {
        name: "x".into(),
        also: Vec::new(),
        seed: 0,
        stage: stage.into_stage(),
        params,
        wires: Vec::new(),
    }
}

/// The key of an `Optimize` stage with these parameters in RON.
fn key_of(fields: &str) -> Digest {
    let node = node_of("Optimize", Tree::read(fields).unwrap().json());
    Recipe {
        node: &node,
        inputs: &BTreeMap::new(),
        sources: &[],
        device: "cpu",
        salt: None,
    }
    .key()
}

/// A source or an input, told from others by a number.
fn digest_of(number: usize) -> Digest {
    blake3::hash(number.to_string().as_bytes()).into()
}

#[test]
fn a_key_is_what_it_always_was() {
    const INPUTS: [&str; 12] = [
        "images.0",
        "images.1",
        "images.2",
        "images.3",
        "images.4",
        "images.5",
        "images.6",
        "images.7",
        "images.8",
        "images.9",
        "images.10",
        "images.11",
    ];
    let (mut node, _) = sum("s", 1, &[]);
    node.seed = 7;
    node.params = json!({
        "number": 3,
        "rate": 0.001,
        "empty": {},
        "list": [1, "b"],
        "guidance": {"Vsd": {"lora": {"rank": 4}, "every": 3}},
        "guidance_scale": 7.5,
    });
    let source = |name: &str| Source {
        name: name.into(),
        digest: digest_of(name.len()),
    };
    let recipe = Recipe {
        node: &node,
        inputs: &INPUTS
            .map(String::from)
            .into_iter()
            .zip((0..).map(digest_of))
            .collect(),
        sources: &["lpips.2", "photos and poses", "lpips.10"].map(source),
        device: "gpu: one",
        salt: Some("mine"),
    };
    let key = "ed8369e20a4a0516dbf79a87b7a6d2506b3c39272d1cbb4d40fe0fb348d04e46";
    assert_eq!(recipe.key().to_string(), key);
}

#[test]
fn one_value_has_one_text() {
    let key = key_of("(steps: 100, guidance: Vsd(lora_every: 3))");
    assert_eq!(
        key,
        key_of("(guidance: Vsd(lora_every: 0x3,),\n /* first */ steps: 1_00)")
    );
    assert_ne!(key, key_of("(steps: 101, guidance: Vsd(lora_every: 3))"));
    assert_ne!(key, key_of("(steps: 100, guidance: Vsd(lora_every: 1))"));
    assert_ne!(key, key_of("(steps: 100, guidance: Rsd())"));
    assert_ne!(
        key,
        key_of("(steps: 100, guidance: Vsd(lora_every: 3), precision: Bf16)")
    );
}

#[test]
fn names_of_inputs_and_stages_are_no_part_of_a_key_but_digests_are() {
    let params = |from: &str| json!({"images": from});
    let node = |from: &str| {
        let stage = AnyStage::from_parameters("Fit", params(from)).unwrap();
        let params = stage.parameters().unwrap();
        Node {
            name: from.into(),
            also: Vec::new(),
            seed: 0,
            stage: stage.into_stage(),
            params,
            wires: Vec::new(),
        }
    };
    let a = node("a");
    let b = node("b");
    let inputs = |text: &str| {
        let digest = Digest::from(blake3::hash(text.as_bytes()));
        BTreeMap::from([("images".to_owned(), digest)])
    };
    let one = inputs("1");
    let two = inputs("2");
    let key = |node, inputs, salt| {
        Recipe {
            node,
            inputs,
            sources: &[],
            device: "cpu",
            salt,
        }
        .key()
    };
    assert_eq!(key(&a, &one, None), key(&b, &one, None));
    assert_ne!(key(&a, &one, None), key(&a, &two, None));
    assert_ne!(key(&a, &one, None), key(&a, &one, Some("s")));
}

#[test]
fn only_what_computes_on_the_chosen_device_has_it_in_its_key() {
    for kind in KINDS {
        let node = node_of(kind, json!({}));
        let key = |device| {
            Recipe {
                node: &node,
                inputs: &BTreeMap::new(),
                sources: &[],
                device,
                salt: None,
            }
            .key()
        };
        let depends = ["Encode", "Optimize", "Decode", "Fit", "Sync", "Render"].contains(kind);
        assert_eq!(key("cpu") != key("gpu: one"), depends, "{kind}");
        assert_eq!(key("gpu: one") != key("gpu: another"), depends, "{kind}");
    }
}

/// Numbers in spellings that mean the same.
fn spellings(number: f64) -> [String; 3] {
    [
        format!("{number:?}"),
        format!("{number:e}"),
        format!("+{number:?}"),
    ]
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
            prop::collection::btree_map("[a-b]{1,2}", inner.clone(), 0..3)
                .prop_map(|fields| json!(fields)),
            ("[A-B]{1}", inner).prop_map(|(name, content)| json!({ name: content })),
        ]
    });
    prop::collection::btree_map("[a-c]", nested, 0..4).prop_map(|fields| json!(fields))
}

/// Fields in another order, in RON.
fn shuffled(fields: &Value, order: u64) -> String {
    let mut fields: Vec<(usize, String)> = fields
        .as_object()
        .unwrap()
        .iter()
        .enumerate()
        .map(|(at, (name, value))| (at, format!("{name}: {}", ron(value, order))))
        .collect();
    fields.sort_by_key(|(at, _)| round_seed(order, *at as u32));
    format!(
        "({})",
        fields
            .into_iter()
            .map(|(_, field)| field)
            .collect::<Vec<_>>()
            .join(", ")
    )
}

/// A value as RON has it, numbers spelt in one of several ways.
fn ron(value: &Value, order: u64) -> String {
    match (variant(value), value) {
        (Some((name, fields @ Value::Object(_))), _) => {
            format!("{name}{}", shuffled(fields, order))
        }
        (Some((name, content)), _) => format!("{name}({})", ron(content, order)),
        (None, Value::Object(_)) => shuffled(value, order),
        // `()` is nothing, not a list without items.
        (None, Value::Array(items)) if items.is_empty() => "[]".into(),
        (None, Value::Array(items)) => {
            format!(
                "({})",
                items
                    .iter()
                    .map(|item| ron(item, order))
                    .collect::<Vec<_>>()
                    .join(", ")
            )
        }
        (None, Value::String(text)) if text.chars().next().is_some_and(char::is_uppercase) => {
            text.clone()
        }
        (None, Value::Null) => "None".into(),
        (None, Value::Number(number)) if number.is_f64() => {
            spellings(number.as_f64().unwrap())[(order % 3) as usize].clone()
        }
        (None, other) => other.to_string(),
    }
}

/// The key of a stage of a kind with these parameters in RON, as a pipeline file has them.
fn key_of_kind(kind: &str, fields: &str) -> Result<Digest, String> {
    let json = Tree::read(fields)
        .map_err(|error| format!("{fields}: {error:?}"))?
        .json();
    let stage =
        AnyStage::from_parameters(kind, json).map_err(|error| format!("{fields}: {error}"))?;
    let params = stage.parameters().unwrap();
    let node = Node {
        name: "x".into(),
        also: Vec::new(),
        seed: 0,
        stage: stage.into_stage(),
        params,
        wires: Vec::new(),
    };
    let recipe = Recipe {
        node: &node,
        inputs: &BTreeMap::new(),
        sources: &[],
        device: "cpu",
        salt: None,
    };
    Ok(recipe.key())
}

/// Every number, truth value and text of some parameters, changed one at a time.
fn changes(value: &Value) -> Vec<Value> {
    match value {
        Value::Bool(truth) => vec![(!truth).into()],
        Value::Number(number) if number.is_f64() => {
            vec![(number.as_f64().unwrap() * 1.5 + 0.125).into()]
        }
        Value::Number(number) => vec![(number.as_u64().unwrap_or(0) + 1).into()],
        Value::Object(fields) => {
            let with = |(name, value): (&String, &Value)| {
                changes(value)
                    .into_iter()
                    .map(|changed| {
                        let mut fields = fields.clone();
                        fields.insert(name.clone(), changed);
                        Value::Object(fields)
                    })
                    .collect::<Vec<_>>()
            };
            fields.iter().flat_map(with).collect()
        }
        Value::Array(items) => {
            let with = |(at, value): (usize, &Value)| {
                changes(value)
                    .into_iter()
                    .map(move |changed| {
                        let mut items = items.clone();
                        items[at] = changed;
                        Value::Array(items)
                    })
                    .collect::<Vec<_>>()
            };
            items.iter().enumerate().flat_map(with).collect()
        }
        Value::Null | Value::String(_) => Vec::new(),
    }
}

/// The parameters of a kind without its inputs.
fn defaults(kind: &str) -> Value {
    let stage = AnyStage::from_parameters(kind, json!({})).unwrap();
    let mut params = stage.parameters().unwrap();
    for port in stage.stage().inputs() {
        params.as_object_mut().unwrap().remove(port.name);
    }
    params
}

proptest! {
    #[test]
    fn order_spelling_and_defaults_written_out_change_no_key(order in any::<u64>(), left_out in any::<u64>()) {
        for kind in KINDS {
            let written = defaults(kind);
            let mut some = written.clone();
            let names: Vec<String> = some.as_object().unwrap().keys().cloned().collect();
            for (_, name) in names.iter().enumerate().filter(|(at, _)| left_out >> (at % 64) & 1 == 1) {
                some.as_object_mut().unwrap().remove(name);
            }
            let key = key_of_kind(kind, "()").unwrap();
            prop_assert_eq!(key_of_kind(kind, &shuffled(&written, order)), Ok(key), "{}", kind);
            prop_assert_eq!(key_of_kind(kind, &shuffled(&some, order)), Ok(key), "{}", kind);
        }
    }
}

#[test]
fn every_changed_value_gives_another_key() {
    for kind in KINDS {
        let mut keys = vec![key_of_kind(kind, "()").unwrap()];
        // Values that make no sense are refused before they have a key.
        keys.extend(
            changes(&defaults(kind))
                .iter()
                .filter_map(|changed| key_of_kind(kind, &shuffled(changed, 0)).ok()),
        );
        let count = keys.len();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), count, "{kind}: a change that changes no key");
    }
}
