//! `tokenizer.json`: a tokenizer in one file, as transformers writes it since version 5. Knows no text.

use std::collections::BTreeMap;

use formats::FileBytes;
use serde::Deserialize;

use crate::error::ModelError;

/// Words and the pairs that are merged to them.
pub(crate) struct Tables {
    pub(crate) vocabulary: BTreeMap<String, u32>,
    /// Pairs of symbols, joined by a space, in the order in which they are merged.
    pub(crate) merges: Vec<String>,
}

#[derive(Deserialize)]
struct Page {
    model: Model,
    #[serde(default)]
    added_tokens: Vec<Added>,
}

#[derive(Deserialize)]
struct Model {
    #[serde(rename = "type", default)]
    kind: Option<String>,
    vocab: BTreeMap<String, u32>,
    merges: Vec<Merge>,
}

/// Older files write a pair as one text, newer ones as two.
#[derive(Deserialize)]
#[serde(untagged)]
enum Merge {
    Joined(String),
    Pair([String; 2]),
}

#[derive(Deserialize)]
struct Added {
    id: u32,
    content: String,
}

/// Reads the tables of a file. An error names it and says what was expected.
pub(crate) fn read(file: &FileBytes) -> Result<Tables, ModelError> {
    let page: Page = serde_json::from_slice(file).map_err(|error| {
        let problem = format!(
            "is not a tokenizer's file with `model.vocab` and `model.merges` ({error}); save the tokenizer again with \
             `save_pretrained(folder)`"
        );
        ModelError::file(file.name(), problem)
    })?;
    if let Some(kind) = page.model.kind.filter(|kind| kind != "BPE") {
        let problem =
            format!("is a {kind} tokenizer; expected byte-pair encoding, `BPE`, as CLIP has it");
        return Err(ModelError::file(file.name(), problem));
    }
    let mut vocabulary = page.model.vocab;
    // The marks of begin and end may stand among the added tokens only.
    vocabulary.extend(
        page.added_tokens
            .into_iter()
            .map(|added| (added.content, added.id)),
    );
    let joined = |merge| match merge {
        Merge::Joined(pair) => pair,
        Merge::Pair([first, second]) => format!("{first} {second}"),
    };
    Ok(Tables {
        vocabulary,
        merges: page.model.merges.into_iter().map(joined).collect(),
    })
}
