//! The arms of a pipeline, as they stand in its files: named ones, and one for each combination of
//! a matrix. Knows nothing of stages.

use std::collections::BTreeMap;

use serde_json::Value as Json;

use super::fault::FieldPath;
use super::layers::Layer;
use super::problem::Problem;
use super::set::{Override, variant};
use super::text::{Tree, Value};
use super::unroll::check_name;
use crate::pipeline::experiment::{Arm, Experiment};

/// More arms than this are taken for a mistake.
const MOST_ARMS: usize = 1000;

/// The row that `Evaluate` gives the field it measures.
const ROW: &str = "sr_nerf";

/// One arm, and what it changes.
pub struct Variant {
    pub name: String,
    /// What it changes, in order.
    pub changes: Vec<Override>,
}

/// All arms of a file and those that it extends; none where nothing is compared. An arm replaces
/// that of the same name in an extended file; a matrix, with what belongs to it, replaces a matrix.
pub fn read(layers: &[Layer]) -> Result<Vec<Variant>, Problem> {
    let mut arms: Vec<Variant> = Vec::new();
    // The innermost file first, so that its arms keep their places and outer files replace them by
    // name.
    for layer in layers.iter().rev() {
        for arm in named(layer)? {
            match arms.iter_mut().find(|known| known.name == arm.name) {
                Some(known) => *known = arm,
                None => arms.push(arm),
            }
        }
    }
    let of_matrix = ["matrix", "include", "exclude"];
    let with_matrix = |layer: &&Layer| of_matrix.iter().any(|name| layer.field(name).is_some());
    if let Some(layer) = layers.iter().find(with_matrix) {
        for arm in combined(layer)? {
            // An arm's name is a folder: two of one name would overwrite each other's results.
            if arms.iter().any(|known| known.name == arm.name) {
                let message = format!("there are two arms `{}`", arm.name);
                let problem = layer.problem("matrix", message);
                return Err(problem.with_help("exclude one of the two combinations"));
            }
            arms.push(arm);
        }
    }
    Ok(arms)
}

fn named(layer: &Layer) -> Result<Vec<Variant>, Problem> {
    let Some(arms) = layer.field("arms") else {
        return Ok(Vec::new());
    };
    let entries = layer.entries(arms, "arms: { \"name\": { \"fit.steps\": 2000 } }")?;
    let arm = |entry: &super::text::Entry| {
        check_name(&entry.name, &FieldPath::root("arms"))
            .map_err(|fault| layer.source.problem(entry.span.clone(), fault.message))?;
        Ok(Variant {
            name: entry.name.clone(),
            changes: layer.differences(&entry.tree)?,
        })
    };
    entries.iter().map(arm).collect()
}

/// The combinations of a matrix but for those that are excluded, and those that are included.
fn combined(layer: &Layer) -> Result<Vec<Variant>, Problem> {
    let axes = match layer.field("matrix") {
        Some(matrix) => layer.entries(matrix, "a matrix: { \"fit.steps\": [1000, 2000] }")?,
        None => &[],
    };
    let mut combinations: Vec<Vec<Override>> = Vec::new();
    // One empty combination for the axes to extend. Without axes there must be none: `include`
    // alone can give arms.
    if !axes.is_empty() {
        combinations.push(Vec::new());
    }
    for axis in axes {
        let Value::List(values) = &axis.tree.value else {
            let span = axis.tree.span.clone();
            return Err(layer
                .source
                .problem(span, "expected a list of values: [1000, 2000]"));
        };
        let with = |before: &Vec<Override>, value: &Tree| {
            let entry = super::text::Entry {
                name: axis.name.clone(),
                span: axis.span.clone(),
                tree: value.clone(),
            };
            let change = Override::of_entry(&layer.source, &entry);
            [&before[..], &[change]].concat()
        };
        combinations = combinations
            .iter()
            .flat_map(|before| values.iter().map(move |value| with(before, value)))
            .collect();
        // Inside of the loop: each further axis multiplies, and would fill the memory before anyone
        // counts.
        if combinations.len() > MOST_ARMS {
            let message = format!("this matrix has more than {MOST_ARMS} combinations");
            return Err(layer.problem("matrix", message));
        }
    }
    let excluded = differences_in(layer, "exclude")?;
    combinations.retain(|combination| !excluded.iter().any(|part| is_part(part, combination)));
    // After the exclusion, so that what is named one by one is never excluded.
    combinations.extend(differences_in(layer, "include")?);
    let arm = |changes: Vec<Override>| Variant {
        name: name_of(&changes),
        changes,
    };
    Ok(combinations.into_iter().map(arm).collect())
}

/// A list of maps of paths and values.
fn differences_in(layer: &Layer, name: &str) -> Result<Vec<Vec<Override>>, Problem> {
    match layer.field(name).map(|tree| &tree.value) {
        None => Ok(Vec::new()),
        Some(Value::List(items)) => items.iter().map(|item| layer.differences(item)).collect(),
        Some(_) => Err(layer.problem(name, "expected a list: [{ \"fit.steps\": 2000 }]")),
    }
}

/// Whether a combination has all these values.
fn is_part(part: &[Override], combination: &[Override]) -> bool {
    part.iter().all(|wanted| {
        let same = |has: &Override| has.path() == wanted.path() && has.value() == wanted.value();
        combination.iter().any(same)
    })
}

/// The name of a combination, which is also that of a folder: `guidance-Vsd_lora_every-3`.
fn name_of(changes: &[Override]) -> String {
    let words = changes.iter().map(|change| {
        let path = change.path();
        let field = path.rsplit('.').next().unwrap_or_default();
        format!("{field}-{}", word(change.value()))
    });
    words.collect::<Vec<_>>().join("_")
}

/// A value in a word: a variant by its name, and what else it says behind it.
fn word(value: &Json) -> String {
    let text = match (variant(value), value) {
        (Some((name, content)), _) if is_plain(content) => name.to_owned(),
        (Some((name, content)), _) => format!("{name}{content}"),
        // Without the quotes that JSON would put around it.
        (None, Json::String(text)) => text.clone(),
        (None, other) => other.to_string(),
    };
    // The word becomes part of a folder's name, on every system.
    let safe = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    let text: String = text.chars().map(safe).collect();
    let parts: Vec<&str> = text.split('-').filter(|part| !part.is_empty()).collect();
    parts.join("-")
}

fn is_plain(content: &Json) -> bool {
    content.as_object().is_some_and(serde_json::Map::is_empty)
}

/// What is compared with what, for the record of a run.
pub fn experiment(arms: &[Variant], layers: &[Layer]) -> Result<Experiment, Problem> {
    let names: Vec<&str> = arms.iter().map(|arm| arm.name.as_str()).collect();
    let chosen = |field: &str, of: fn(&Layer) -> Option<&String>| {
        let Some(layer) = layers.iter().find(|layer| of(layer).is_some()) else {
            return Ok(None);
        };
        let name = of(layer).cloned().unwrap_or_default();
        if names.contains(&name.as_str()) {
            return Ok(Some(name));
        }
        let problem = layer.problem(field, format!("there is no arm `{name}`"));
        Err(problem.with_names(&name, names.iter().copied()))
    };
    let baseline = chosen("baseline", |layer| layer.document.baseline.as_ref())?;
    let bound = chosen("bound", |layer| layer.document.bound.as_ref())?;
    let row = layers.iter().find_map(|layer| layer.document.row.clone());
    let told = |arm: &Variant| Arm {
        name: arm.name.clone(),
        differences: arm
            .changes
            .iter()
            .map(|change| (change.path(), change.value_text()))
            .collect::<BTreeMap<_, _>>(),
    };
    Ok(Experiment {
        arms: arms.iter().map(told).collect(),
        baseline: baseline.unwrap_or_else(|| names.first().map_or(String::new(), |n| (*n).into())),
        bound,
        seeds: seeds(layers)?,
        row: row.unwrap_or_else(|| ROW.to_owned()),
    })
}

fn seeds(layers: &[Layer]) -> Result<Vec<u64>, Problem> {
    let Some(layer) = layers.iter().find(|layer| layer.document.seeds.is_some()) else {
        return Ok(Vec::new());
    };
    let seeds = layer.document.seeds.clone().unwrap_or_default();
    let twice = |at: &usize| seeds[..*at].contains(&seeds[*at]);
    match (0..seeds.len()).find(twice) {
        Some(at) => Err(layer.problem("seeds", format!("seed {} is given twice", seeds[at]))),
        None => Ok(seeds),
    }
}
