//! What happened while a stage ran: `log.jsonl`, one JSON object per line, with the provenance in a
//! file beside it.

use std::path::Path;

use serde_json::{Map, Value};

use crate::artifact::{Artifact, ArtifactKind};
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::provenance::{self, Provenance};

const FILE: &str = "log.jsonl";

/// What a stage tells of its course, one JSON object a line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Log {
    /// The lines in order, each an object such as `{"step": 1, "loss": 0.5}`.
    pub lines: Vec<Value>,
}

/// A line of the file.
pub(crate) type LogLine = Map<String, Value>;

impl Artifact for Log {
    const KIND: ArtifactKind = ArtifactKind::Log;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        let mut text = String::new();
        for (index, line) in self.lines.iter().enumerate() {
            // Readers of JSON lines, such as pandas, expect an object a line.
            if !line.is_object() {
                return Err(SchemaError::content(
                    format!("line {}", index + 1),
                    format!("is {line}; expected an object"),
                ));
            }
            text += &canonical::line(line)?;
            text.push('\n');
        }
        canonical::write(folder, FILE, text.as_bytes())?;
        canonical::write(
            folder,
            provenance::FILE,
            canonical::page(provenance)?.as_bytes(),
        )
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        let path = folder.join(FILE);
        let text = std::fs::read_to_string(&path).map_err(|error| SchemaError::io(&path, error))?;
        // Each line by itself, so that an error has the line's number.
        let parse = |(index, line): (usize, &str)| match serde_json::from_str::<LogLine>(line) {
            Ok(line) => Ok(Value::Object(line)),
            Err(error) => Err(SchemaError::malformed(
                &path,
                format!("line {}", index + 1),
                error,
            )),
        };
        Ok(Self {
            lines: text
                .lines()
                .enumerate()
                .map(parse)
                .collect::<Result<_, _>>()?,
        })
    }

    fn semantic_digest(&self) -> Digest {
        let mut hasher = ContentHasher::new(Self::KIND);
        hasher.count(self.lines.len());
        self.lines.iter().for_each(|line| hasher.json(line));
        hasher.finish()
    }
}
