//! From a pipeline file and overrides to checked stages wired to each other, or to one problem with
//! its place in the text.

mod arms;
mod draft;
pub mod experiment;
pub mod fault;
pub mod grammar;
pub mod graph;
pub mod init;
mod layers;
mod merge;
pub mod problem;
mod reference;
mod ron_parser;
pub mod set;
mod shard;
pub mod text;
pub mod unroll;

#[cfg(test)]
mod differences;
#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use ron::error::SpannedError;

use draft::Draft;
use fault::FieldPath;
use graph::Graph;
use layers::Layer;
pub use layers::with_bases;
use merge::Merge;
use problem::{Problem, SourceText};
use set::Override;
use text::Tree;
use unroll::Seeds;

/// Reads a pipeline and the files that it extends (itself first, see [`with_bases`]), applies the
/// overrides in order, unrolls and checks it, with all its arms.
pub fn load(files: &[SourceText], overrides: &[Override]) -> Result<Graph, Problem> {
    let layers = files
        .iter()
        .map(Layer::read)
        .collect::<Result<Vec<_>, _>>()?;
    let mut draft = layers::lay(&layers)?;
    // Before the arms: an override is of all of them, and an arm has the last word.
    draft.apply_all(overrides.to_vec())?;
    let arms = arms::read(&layers)?;
    if arms.is_empty() {
        return wanted(&draft, Seeds::all(draft.pipeline.seed), &layers);
    }
    let experiment = arms::experiment(&arms, &layers)?;
    let mut merge = Merge::new(draft.pipeline.name.clone());
    for arm in arms {
        let mut own = draft.clone();
        own.apply_all(arm.changes)?;
        for (seeds, folder) in seeds(&own, &experiment.seeds)
            .iter()
            .zip(experiment.folders(&arm.name))
        {
            // Each arm is unrolled by itself, so that its mistakes are found with their places.
            // What arms share is found afterwards.
            merge.add(&folder, wanted(&own, *seeds, &layers)?);
        }
    }
    let mut graph = merge.finish();
    graph.experiment = Some(experiment);
    Ok(graph)
}

/// The seeds of each run of an arm.
fn seeds(draft: &Draft, seeds: &[u64]) -> Vec<Seeds> {
    let sources = draft.pipeline.seed;
    // An experiment's seeds leave the photos alone: all runs are measured against the same ones.
    let with = |&computing| Seeds { computing, sources };
    match seeds {
        [] => vec![Seeds::all(sources)],
        _ => seeds.iter().map(with).collect(),
    }
}

/// The stages that the file wants, and all that they need.
fn wanted(draft: &Draft, seeds: Seeds, layers: &[Layer]) -> Result<Graph, Problem> {
    let graph = draft.graph(seeds, layers)?;
    // The outermost file that names targets decides.
    let asking = layers.iter().find(|layer| layer.document.targets.is_some());
    let Some((layer, targets)) =
        asking.and_then(|layer| Some((layer, layer.document.targets.as_ref()?)))
    else {
        return Ok(graph);
    };
    let mut wanted = BTreeSet::new();
    for target in targets {
        let found = graph.find(target);
        wanted.extend(found.map_err(|unknown| layer.problem("targets", unknown.to_string()))?);
    }
    let needed = graph.needed(&wanted);
    Ok(graph.only(&needed))
}

/// A text that the grammar does not take.
fn malformed(source: &SourceText, error: &SpannedError) -> Problem {
    use ron::Error::{DuplicateStructField, NoSuchEnumVariant, NoSuchStructField};
    let start = source.offset(error.span.start.line, error.span.start.col);
    let end = source.offset(error.span.end.line, error.span.end.col);
    // `ron` tells where it stopped reading, which is behind the name that it did not know.
    let word = |name: &str| word_before(&source.text, name, end.max(start)).unwrap_or(start..end);
    match &error.code {
        NoSuchEnumVariant {
            expected, found, ..
        } => {
            let problem =
                source.problem(word(found), format!("there is no `{found}` to choose here"));
            problem.with_names(found, expected.iter().copied())
        }
        NoSuchStructField {
            expected,
            found,
            outer,
        } => {
            let owner = outer
                .as_ref()
                .map(|outer| format!("`{outer}` has "))
                .unwrap_or("there is ".into());
            let problem = source.problem(word(found), format!("{owner}no field `{found}`"));
            problem.with_names(found, expected.iter().copied())
        }
        DuplicateStructField { field, .. } => {
            source.problem(word(field), format!("`{field}` is given twice"))
        }
        other => source.problem(start..end, other.to_string()),
    }
}

/// The last place at or before `end` where a word stands: readers notice an unknown name only when
/// they are past it.
fn word_before(text: &str, word: &str, end: usize) -> Option<std::ops::Range<usize>> {
    let window = text
        // `get`, since this place can lie inside of a character.
        .get(..(end + word.len()).min(text.len()))
        .unwrap_or(text);
    window.rfind(word).map(|at| at..at + word.len())
}

/// Where a place stands in a text: its value, or as much of the way there as the text spells out.
fn span(tree: &Tree, place: &FieldPath) -> std::ops::Range<usize> {
    let mut at = tree;
    let mut span = 0..0;
    for (depth, name) in place.0.iter().enumerate() {
        // What the text does not spell out has its default: the nearest thing above it is pointed
        // at.
        let Some(entry) = at.entry(name) else { break };
        span = if depth + 1 == place.0.len() && !is_stage(&entry.tree) {
            entry.tree.span.clone()
        } else {
            entry.span.clone()
        };
        at = &entry.tree;
    }
    span
}

/// A stage or a loop is pointed at by its name, not by all that it says.
fn is_stage(tree: &Tree) -> bool {
    matches!(
        &tree.value,
        text::Value::Struct(Some(_), _) | text::Value::Map(_)
    )
}
