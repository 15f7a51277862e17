//! What stages read beside their inputs: files of the user's. Knows no keys and no results.

use std::collections::{BTreeMap, BTreeSet};

use stages::{Source, StageError};

use crate::pipeline::graph::Graph;
use crate::store::Store;

/// A stage that reads something beside its inputs which is not there, or not as it should be.
#[derive(Debug, thiserror::Error)]
#[error("stage `{stage}`: {error}")]
pub struct SourceError {
    pub stage: String,
    /// What is wrong.
    pub error: StageError,
}

/// What the stages that are needed read beside their inputs; stages of one kind with the same
/// parameters read the same. What a store remembers of files that have not changed is not read
/// again.
pub fn sources(
    graph: &Graph,
    needed: &BTreeSet<usize>,
    store: &Store,
) -> Result<Vec<Vec<Source>>, SourceError> {
    let mut known: BTreeMap<String, Vec<Source>> = BTreeMap::new();
    let mut all = vec![Vec::new(); graph.nodes.len()];
    for &at in needed {
        let node = &graph.nodes[at];
        // What names no place reads nothing; most stages are such, and there may be thousands.
        if node.stage.locations().is_empty() {
            continue;
        }
        let what = format!(
            "{} {} {}",
            node.stage.kind(),
            node.stage.version(),
            node.params
        );
        if !known.contains_key(&what) {
            let ask = || {
                node.stage.sources().map_err(|error| SourceError {
                    stage: node.name.clone(),
                    error,
                })
            };
            let read = match node.stage.source_files() {
                // Photos and weights can have many gigabytes. They are hashed again only when a
                // file has changed.
                Some(files) if !files.is_empty() => {
                    store.cache.while_unchanged(&what, &files, ask)?
                }
                _ => ask()?,
            };
            known.insert(what.clone(), read);
        }
        all[at].clone_from(&known[&what]);
    }
    Ok(all)
}
