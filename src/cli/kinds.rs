//! `kinds`: prints the reference of stage kinds, which is made from the code. Writes nothing.

use clap::Args;
use serde_json::Value;
use stages::KINDS;

use super::error::Error;
use crate::kinds::{page, schema, section};
use crate::terminal::output::{print, print_json};

#[derive(Args)]
pub struct Kinds {
    /// The kind, such as Fit; by default all of them, a line each
    kind: Option<String>,
    /// The whole reference
    #[arg(long, conflicts_with = "kind")]
    all: bool,
}

impl Kinds {
    /// Prints what was asked for.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let kind = self.kind.as_deref().map(known).transpose()?;
        match kind {
            Some(kind) if json => print_json(&schema(kind)),
            Some(kind) => print(&section(kind).trim_end()),
            None if json => print_json(&schemas()),
            None if self.all => print(&page().trim_end()),
            None => print(&list().trim_end()),
        }
        Ok(())
    }
}

/// The kind of this name.
fn known(name: &str) -> Result<&'static str, Error> {
    let same = |kind: &&&'static str| kind.eq_ignore_ascii_case(name);
    KINDS.iter().find(same).copied().ok_or_else(|| {
        Error::usage(
            format!("there is no kind `{name}`"),
            format!("the kinds are {}", KINDS.join(", ")),
        )
    })
}

/// The schemas of all kinds by name.
fn schemas() -> Value {
    KINDS
        .iter()
        .map(|kind| ((*kind).to_owned(), schema(kind)))
        .collect::<serde_json::Map<_, _>>()
        .into()
}

/// A line for each kind: its name, and the first sentence about it.
fn list() -> String {
    let line = |kind: &&str| {
        let schema = schema(kind);
        let text = schema["description"].as_str().unwrap_or_default();
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        // With the blank, so that the dot in `0.5` or `i3ds.ron` ends no sentence.
        let first = text.split_once(". ").map_or(&text[..], |(first, _)| first);
        format!("{kind:12} {}\n", first.trim_end_matches('.'))
    };
    KINDS.iter().map(line).collect()
}
