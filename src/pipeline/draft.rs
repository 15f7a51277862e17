//! A pipeline being put together: its stages so far, and who changed what of them. Knows nothing of
//! how differences are written.

use super::fault::{Fault, FieldPath};
use super::grammar::{Named, Pipeline};
use super::graph::Graph;
use super::layers::{Layer, locate};
use super::problem::Problem;
use super::set::Override;
use super::span;
use super::unroll::{Seeds, check_name, unroll};

/// A pipeline being put together.
#[derive(Clone)]
pub struct Draft {
    /// It as it is so far.
    pub pipeline: Pipeline,
    /// What was changed, in order, and where.
    changes: Vec<(Override, FieldPath)>,
}

impl Default for Draft {
    fn default() -> Self {
        let pipeline = Pipeline {
            name: String::new(),
            seed: 0,
            stages: Named::default(),
        };
        Self {
            pipeline,
            changes: Vec::new(),
        }
    }
}

impl Draft {
    /// Changes one value.
    pub fn apply(&mut self, change: Override) -> Result<(), Problem> {
        let place = change.apply(&mut self.pipeline)?;
        self.changes.push((change, place));
        Ok(())
    }

    /// Changes several values, in order.
    pub fn apply_all(&mut self, changes: Vec<Override>) -> Result<(), Problem> {
        changes
            .into_iter()
            .try_for_each(|change| self.apply(change))
    }

    /// Forgets who changed what is now as a file says.
    pub fn forget(&mut self, place: &FieldPath) {
        self.changes.retain(|(_, at)| !at.0.starts_with(&place.0));
    }

    /// Unrolls and checks it.
    pub fn graph(&self, seeds: Seeds, layers: &[Layer]) -> Result<Graph, Problem> {
        let checked = check_name(&self.pipeline.name, &FieldPath::root("name"))
            .and_then(|()| unroll(&self.pipeline, seeds));
        checked.map_err(|fault| self.located(fault, layers))
    }

    /// A fault with its place looked up: in the change that caused it, or else in a file.
    fn located(&self, fault: Fault, layers: &[Layer]) -> Problem {
        let touches = |place: &FieldPath| {
            // In both directions: the change of a field can break its stage, and that of a whole
            // value one of its fields.
            place.0.starts_with(&fault.place.0) || fault.place.0.starts_with(&place.0)
        };
        // The latest change of a value is the one that counts.
        let mut causes = self.changes.iter().rev();
        let cause = causes.find(|(_, place)| touches(place));
        let problem = match (cause, locate(layers, &fault.place)) {
            (Some((change, _)), _) => change
                .source
                .problem(change.value_span.clone(), &fault.message),
            (None, Some(layer)) => layer
                .source
                .problem(span(&layer.tree, &fault.place), &fault.message),
            (None, None) => unreachable!("a pipeline is read from at least one file"),
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
}
