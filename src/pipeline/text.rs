//! RON text as a tree that keeps variant names and remembers where each value stands.
//!
//! The `ron` crate gives pipelines their types; this tree answers what serde cannot: where in the
//! file a value is, and what the value of a `--set` is before anyone knows its type. Knows nothing
//! of pipelines.

use std::ops::Range;

use serde_json::{Map, Value as Json};

use super::ron_parser::RonParser;

/// A value and the bytes of the text that it spans.
#[derive(Clone, Debug)]
pub struct Tree {
    /// Where it stands.
    pub span: Range<usize>,
    /// What stands there.
    pub value: Value,
}

/// A value in RON.
#[derive(Clone, Debug)]
pub enum Value {
    /// A number, a string, a truth value, or `None` as null.
    Scalar(Json),
    /// `Name`, `Name(..)` or `(..)` without named fields.
    Tuple(Option<String>, Vec<Tree>),
    /// `Name(field: ..)` or `(field: ..)`.
    Struct(Option<String>, Vec<Entry>),
    /// `[..]`.
    List(Vec<Tree>),
    /// `{"key": ..}`.
    Map(Vec<Entry>),
}

/// A named value in a struct or map.
#[derive(Clone, Debug)]
pub struct Entry {
    /// The field or key.
    pub name: String,
    /// Where the name stands.
    pub span: Range<usize>,
    /// Its value.
    pub tree: Tree,
}

/// Text that is not RON.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Garbled {
    /// Where reading stopped.
    pub at: usize,
    /// What should stand there.
    pub expected: &'static str,
}

impl Tree {
    /// Reads a whole text.
    pub fn read(text: &str) -> Result<Self, Garbled> {
        RonParser::new(text).whole()
    }

    /// The entry of this name, through a variant that is not named: `guidance.lora_every` finds its
    /// way into `Vsd(..)`.
    pub fn entry(&self, name: &str) -> Option<&Entry> {
        match &self.value {
            Value::Struct(_, entries) | Value::Map(entries) => {
                entries.iter().find(|entry| entry.name == name)
            }
            Value::Tuple(_, items) if items.len() == 1 => items[0].entry(name),
            _ => None,
        }
    }

    /// The value as serde writes it in JSON: a variant with content is an object with the variant's
    /// name as its only key.
    pub fn json(&self) -> Json {
        match &self.value {
            Value::Scalar(scalar) => scalar.clone(),
            Value::List(items) => items.iter().map(Self::json).collect(),
            // A struct's name is no part of what serde writes; a variant's is the key around its
            // fields.
            Value::Map(entries) | Value::Struct(None, entries) => fields(entries),
            Value::Struct(Some(name), entries) => tagged(name, fields(entries)),
            Value::Tuple(None, items) => items.iter().map(Self::json).collect(),
            Value::Tuple(Some(name), items) => match &items[..] {
                [] => Json::String(name.clone()),
                // serde writes an option without a wrapper, so `Some(3)` and `3` are one value.
                [only] if name == "Some" => only.json(),
                [only] => tagged(name, only.json()),
                more => tagged(name, more.iter().map(Self::json).collect()),
            },
        }
    }
}

fn fields(entries: &[Entry]) -> Json {
    entries
        .iter()
        .map(|entry| (entry.name.clone(), entry.tree.json()))
        .collect::<Map<_, _>>()
        .into()
}

fn tagged(name: &str, content: Json) -> Json {
    Json::Object(Map::from_iter([(name.to_owned(), content)]))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn read(text: &str) -> Json {
        Tree::read(text).unwrap().json()
    }

    #[test]
    fn values_become_what_serde_writes() {
        assert_eq!(read("1e-3"), json!(0.001));
        assert_eq!(read("-4"), json!(-4));
        assert_eq!(read("0x1F"), json!(31));
        assert_eq!(read("Bicubic"), json!("Bicubic"));
        assert_eq!(read("Rsd()"), json!({"Rsd": {}}));
        assert_eq!(
            read("Vsd(lora_every: 3)"),
            json!({"Vsd": {"lora_every": 3}})
        );
        assert_eq!(
            read("Llff(path: \"a \\\"b\\\"\", size: (252, 189))"),
            json!({"Llff": {"path": "a \"b\"", "size": [252, 189]}})
        );
        assert_eq!(read("Some(3)"), json!(3));
        assert_eq!(read("None"), Json::Null);
        assert_eq!(
            read("/* a /* b */ */ [r#\"x\"y\"#, true,] // end"),
            json!(["x\"y", true])
        );
        assert_eq!(read("{\"a\": 1}"), json!({"a": 1}));
    }

    #[test]
    fn entries_are_found_through_variants_with_their_places() {
        let text = "(stages: {\"fit\": Fit(guidance: Vsd(lora_every: 3))})";
        let tree = Tree::read(text).unwrap();
        let found = ["stages", "fit", "guidance", "lora_every"]
            .iter()
            .try_fold(&tree, |t, name| t.entry(name).map(|e| &e.tree));
        assert_eq!(&text[found.unwrap().span.clone()], "3");
    }

    #[test]
    fn garbled_text_is_refused_where_it_goes_wrong() {
        assert_eq!(
            Tree::read("(a: 1, b)").unwrap_err(),
            Garbled {
                at: 8,
                expected: "`:`"
            }
        );
        assert_eq!(
            Tree::read("[1 2]").unwrap_err(),
            Garbled {
                at: 3,
                expected: "`,` or `]`"
            }
        );
        assert_eq!(
            Tree::read("\"open").unwrap_err().expected,
            "a string in quotes"
        );
        assert_eq!(Tree::read("").unwrap_err().expected, "a value");
        assert_eq!(
            Tree::read(&"[".repeat(1000)).unwrap_err().expected,
            "less nesting"
        );
        assert_eq!(Tree::read("é").unwrap().json(), json!("é"));
    }
}
