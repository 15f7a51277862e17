//! From a pipeline file and overrides to checked stages wired to each other, or to one problem with its place in the
//! text.

pub mod fault;
pub mod grammar;
pub mod graph;
pub mod problem;
mod reader;
mod reference;
pub mod set;
mod shard;
pub mod text;
pub mod unroll;

#[cfg(test)]
mod laws;
#[cfg(test)]
mod tests;

use ron::error::SpannedError;
use ron::extensions::Extensions;

use fault::{Fault, Place};
use grammar::Pipeline;
use graph::Graph;
use problem::{Problem, Source};
use set::Override;
use text::Tree;

/// Reads a pipeline, applies the overrides in order, unrolls and checks it.
pub fn load(source: &Source, overrides: &[Override]) -> Result<Graph, Problem> {
    let extensions = Extensions::UNWRAP_VARIANT_NEWTYPES | Extensions::IMPLICIT_SOME;
    let options = ron::Options::default().with_default_extension(extensions);
    let mut pipeline: Pipeline = options
        .from_str(&source.text)
        .map_err(|error| malformed(source, &error))?;
    let mut places = Vec::new();
    for change in overrides {
        places.push(change.apply(&mut pipeline)?);
    }
    let checked = unroll::check_name(&pipeline.name, &Place::root("name"))
        .and_then(|()| unroll::unroll(&pipeline));
    checked.map_err(|fault| located(fault, source, overrides, &places))
}

/// A text that the grammar does not take.
fn malformed(source: &Source, error: &SpannedError) -> Problem {
    use ron::Error::{DuplicateStructField, NoSuchEnumVariant, NoSuchStructField};
    let start = source.offset(error.span.start.line, error.span.start.col);
    let end = source.offset(error.span.end.line, error.span.end.col);
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

/// The last place at or before `end` where a word stands: readers notice an unknown name only when they are past it.
fn word_before(text: &str, word: &str, end: usize) -> Option<std::ops::Range<usize>> {
    let window = text
        .get(..(end + word.len()).min(text.len()))
        .unwrap_or(text);
    window.rfind(word).map(|at| at..at + word.len())
}

/// A fault with its place looked up: in the override that caused it, or else in the file.
fn located(fault: Fault, source: &Source, overrides: &[Override], places: &[Place]) -> Problem {
    let touches =
        |place: &Place| place.0.starts_with(&fault.place.0) || fault.place.0.starts_with(&place.0);
    let mut causes = overrides
        .iter()
        .zip(places)
        .rev()
        .filter(|(_, place)| touches(place) && place.0.len() > 1);
    let problem = match causes.next() {
        Some((change, _)) => change
            .source
            .problem(change.value_span.clone(), &fault.message),
        None => source.problem(span(&source.text, &fault.place), &fault.message),
    };
    let problem = match &fault.unknown {
        Some((found, known)) => problem.with_names(found, known.iter().map(String::as_str)),
        None => problem,
    };
    match fault.help {
        Some(help) => problem.with_help(help),
        None => problem,
    }
}

/// Where a place stands in a text: its value, or as much of the way there as the text spells out.
fn span(text: &str, place: &Place) -> std::ops::Range<usize> {
    let Ok(tree) = Tree::read(text) else {
        return 0..0;
    };
    let (mut at, mut span) = (&tree, 0..0);
    for (depth, name) in place.0.iter().enumerate() {
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
