//! What decides a result, written down as text, and the key that is its digest. Knows nothing of
//! the store that it lies in.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use artifacts_schema::Digest;
use serde::{Deserialize, Serialize};

/// The domain of stage keys; a new number when what is entered changes, or its order.
const DOMAIN: &str = "srnerf-dag stage v1";

/// Everything that decides a result, as text: what (`params.guidance.lora_every`) and its one text
/// (`3`). It is stored beside the result.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Manifest(pub BTreeMap<String, String>);

/// The first step of an entry's path, in the order in which they are hashed.
const SECTIONS: [&str; 8] = [
    "kind", "version", "seed", "device", "salt", "params", "inputs", "sources",
];

/// The hasher before the first entry. It is kept, since hashing the domain takes as long as hashing a
/// short recipe.
static NOTHING: LazyLock<blake3::Hasher> = LazyLock::new(|| blake3::Hasher::new_derive_key(DOMAIN));

impl Manifest {
    /// The digest of all entries: section by section, within one in the order of their paths.
    pub fn key(&self) -> Digest {
        let mut entries: Vec<(&String, &String)> = self.0.iter().collect();
        // Stable, so that within a section the map's order stands.
        entries.sort_by_key(|(path, _)| section(path));
        let mut bytes = Vec::new();
        for part in entries.into_iter().flat_map(|(path, text)| [path, text]) {
            // With the lengths, no two lists of entries have the same bytes: `ab`, `c` is not `a`,
            // `bc`.
            bytes.extend_from_slice(&(part.len() as u64).to_le_bytes());
            bytes.extend_from_slice(part.as_bytes());
        }
        NOTHING.clone().update(&bytes).finalize().into()
    }

    /// Adds an entry.
    pub fn enter(&mut self, path: &str, text: impl ToString) {
        self.0.insert(path.to_owned(), text.to_string());
    }
}

/// The place of an entry's section; unknown ones come last.
fn section(path: &str) -> usize {
    let name = path.split('.').next();
    let known = SECTIONS.iter().position(|section| Some(*section) == name);
    known.unwrap_or(SECTIONS.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_takes_its_entries_section_by_section() {
        let order = [
            "kind",
            "seed",
            "params.a",
            "params.a.b",
            "params.a_b",
            "inputs.10",
            "inputs.2",
            "other",
        ];
        let mut manifest = Manifest::default();
        let mut bytes = Vec::new();
        for path in order {
            manifest.enter(path, "text");
            for part in [path, "text"] {
                bytes.extend((part.len() as u64).to_le_bytes());
                bytes.extend(part.bytes());
            }
        }
        let hash = blake3::derive_key(DOMAIN, &bytes);
        assert_eq!(manifest.key(), Digest::new(hash));
    }
}
