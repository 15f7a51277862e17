//! Moving pictures for people: one GIF each, with the provenance in a file beside them. Knows
//! nothing of how they are made.

use std::collections::BTreeMap;
use std::path::Path;

use crate::artifact::{Artifact, ArtifactKind};
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::provenance::{self, Provenance};

/// How a GIF that can move begins, and its last byte.
const HEAD: &[u8] = b"GIF89a";
const TRAILER: u8 = 0x3b;

/// Moving pictures for people.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Film {
    /// Whole GIF files by their stem. A GIF has 256 colours a frame: it shows the frames, and does
    /// not hold them.
    pub clips: BTreeMap<String, Vec<u8>>,
}

impl Artifact for Film {
    const KIND: ArtifactKind = ArtifactKind::Film;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        canonical::check_names(self.clips.keys().map(String::as_str))?;
        for (name, clip) in &self.clips {
            check(clip)
                .map_err(|problem| SchemaError::content(format!("clip {name:?}"), problem))?;
            canonical::write(folder, &format!("{name}.gif"), clip)?;
        }
        canonical::write(
            folder,
            provenance::FILE,
            canonical::page(provenance)?.as_bytes(),
        )
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        let mut clips = BTreeMap::new();
        for (name, path) in canonical::by_stem(folder, "gif")? {
            let clip = std::fs::read(&path).map_err(|error| SchemaError::io(&path, error))?;
            check(&clip).map_err(|problem| SchemaError::malformed(&path, "GIF", problem))?;
            clips.insert(name, clip);
        }
        Ok(Self { clips })
    }

    fn semantic_digest(&self) -> Digest {
        let mut hasher = ContentHasher::new(Self::KIND);
        hasher.count(self.clips.len());
        for (name, clip) in &self.clips {
            hasher.text(name);
            // The bytes themselves: a GIF's frames are no content that a stage reads.
            hasher.bytes(clip);
        }
        hasher.finish()
    }
}

fn check(clip: &[u8]) -> Result<(), &'static str> {
    // Head and trailer show a file that was cut short, without a decoder.
    match clip.starts_with(HEAD) && clip.last() == Some(&TRAILER) {
        true => Ok(()),
        false => Err("is not a whole GIF file"),
    }
}
