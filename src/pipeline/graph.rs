//! Stages wired to each other, each after those that it reads. Knows nothing of files, keys or how
//! stages run.

use std::collections::{BTreeMap, BTreeSet};

use stages::Stage;

use super::problem::nearest;
use crate::pipeline::experiment::{Experiment, arm_of};

/// A stage in its place.
pub struct Node {
    /// Its name, that of its folder under `out/`: `fit`, `i3ds.1.render` for a stage of a loop's
    /// first round, or `ours/fit` for one of an arm.
    pub name: String,
    /// The names that it has in other arms, where it is the same stage.
    pub also: Vec<String>,
    /// The seed of its random numbers.
    pub seed: u64,
    /// What it does.
    pub stage: Box<dyn Stage>,
    /// All its fields, defaults filled in.
    pub params: serde_json::Value,
    /// Where its inputs come from.
    pub wires: Vec<Wire>,
}

impl Node {
    pub fn names(&self) -> impl Iterator<Item = &str> {
        std::iter::once(&self.name)
            .chain(&self.also)
            .map(String::as_str)
    }

    /// The arms that it is part of.
    pub fn arms(&self) -> BTreeSet<&str> {
        self.names().filter_map(arm_of).collect()
    }

    /// Its name, and how many other stages it stands for: `ours/fit (and 6 more)`.
    pub fn title(&self) -> String {
        match self.also.len() {
            0 => self.name.clone(),
            more => format!("{} (and {more} more)", self.name),
        }
    }
}

/// An input and the output that it reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wire {
    /// The input's name.
    pub input: String,
    /// The stage that it comes from, as its place in [`Graph::nodes`].
    pub from: usize,
    pub output: &'static str,
}

/// All stages of a pipeline, each after those that it reads.
pub struct Graph {
    /// The pipeline's name.
    pub pipeline: String,
    /// The stages.
    pub nodes: Vec<Node>,
    /// What it compares, if it has arms.
    pub experiment: Option<Experiment>,
}

/// A name that no stage of the pipeline has.
#[derive(Debug, thiserror::Error)]
#[error("the pipeline has no stage `{name}`{}", .near.as_ref().map(|near| format!("; did you mean `{near}`?")).unwrap_or_default())]
pub struct UnknownStage {
    name: String,
    near: Option<String>,
}

/// A name that no arm of the pipeline has.
#[derive(Debug, thiserror::Error)]
#[error("the pipeline has no arm `{name}`; {}", if .known.is_empty() { "it has no arms at all".to_owned() } else { format!("its arms: {}", .known) })]
pub struct UnknownArm {
    name: String,
    known: String,
}

impl Graph {
    /// Orders stages so that each comes after those that it reads, in the order given where that
    /// leaves a choice. Where they read each other in a circle: the place of one that does.
    pub fn new(pipeline: String, nodes: Vec<Node>) -> Result<Self, usize> {
        let order = order(&nodes)?;
        let mut place = vec![0; nodes.len()];
        for (new, &old) in order.iter().enumerate() {
            place[old] = new;
        }
        let mut nodes: Vec<(usize, Node)> = place.iter().copied().zip(nodes).collect();
        nodes.sort_by_key(|(new, _)| *new);
        let mut nodes: Vec<Node> = nodes.into_iter().map(|(_, node)| node).collect();
        nodes
            .iter_mut()
            .flat_map(|node| &mut node.wires)
            .for_each(|wire| wire.from = place[wire.from]);
        Ok(Self {
            pipeline,
            nodes,
            experiment: None,
        })
    }

    /// These stages alone, which must read no others.
    pub fn only(self, kept: &BTreeSet<usize>) -> Self {
        let place: BTreeMap<usize, usize> = kept.iter().copied().zip(0..).collect();
        let nodes = self.nodes.into_iter().enumerate();
        let mut nodes: Vec<Node> = nodes
            .filter(|(at, _)| kept.contains(at))
            .map(|(_, node)| node)
            .collect();
        nodes
            .iter_mut()
            .flat_map(|node| &mut node.wires)
            .for_each(|wire| wire.from = place[&wire.from]);
        Self { nodes, ..self }
    }

    /// The stages of an arm.
    pub fn of_arm(&self, arm: &str) -> Result<BTreeSet<usize>, UnknownArm> {
        let arms: Vec<&str> = self
            .experiment
            .iter()
            .flat_map(|all| &all.arms)
            .map(|arm| arm.name.as_str())
            .collect();
        if !arms.contains(&arm) {
            return Err(UnknownArm {
                name: arm.to_owned(),
                known: arms.join(", "),
            });
        }
        let is_of_arm = |at: &usize| self.nodes[*at].arms().contains(arm);
        Ok((0..self.nodes.len()).filter(is_of_arm).collect())
    }

    /// The stages that a user means by a name: a stage (`i3ds.2.render`), a loop or a round of it
    /// (`i3ds`, `i3ds.2`), or a stage of a loop in all rounds (`i3ds.render`); in all arms, or in
    /// the one that stands before it (`ours/i3ds.render`).
    pub fn find(&self, name: &str) -> Result<BTreeSet<usize>, UnknownStage> {
        // With the dot, so that `fit` does not mean `fitting` as well.
        let within = format!("{name}.");
        let means_it =
            |full: &str| full == name || full.starts_with(&within) || without_rounds(full) == name;
        let in_its_arm = |full: &str| {
            full.rsplit_once('/')
                .map_or("", |(_, stage)| stage)
                .to_owned()
        };
        let means = |node: &Node| {
            node.names()
                .any(|full| means_it(full) || means_it(&in_its_arm(full)))
        };
        let found: BTreeSet<usize> = (0..self.nodes.len())
            .filter(|&at| means(&self.nodes[at]))
            .collect();
        if found.is_empty() {
            Err(self.unknown(name))
        } else {
            Ok(found)
        }
    }

    fn unknown(&self, name: &str) -> UnknownStage {
        let short: Vec<String> = self
            .nodes
            .iter()
            .map(|node| without_rounds(&node.name))
            .collect();
        let known: Vec<&str> = self
            .nodes
            .iter()
            .map(|node| node.name.as_str())
            // The short names too, since a user may mean a stage in all rounds.
            .chain(short.iter().map(String::as_str))
            .collect();
        UnknownStage {
            name: name.to_owned(),
            near: nearest(name, &known).map(str::to_owned),
        }
    }

    /// These stages and all that they depend on.
    pub fn needed(&self, wanted: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut needed = wanted.clone();
        // Stages stand behind those that they read, so one pass from the end meets all of them.
        for at in (0..self.nodes.len()).rev() {
            if needed.contains(&at) {
                needed.extend(self.nodes[at].wires.iter().map(|wire| wire.from));
            }
        }
        needed
    }
}

/// `i3ds.1.render` as `i3ds.render`.
fn without_rounds(name: &str) -> String {
    let parts: Vec<&str> = name
        .split('.')
        // Only rounds and shards are numbers: a name that users give begins with a letter.
        .filter(|part| part.parse::<u32>().is_err())
        .collect();
    parts.join(".")
}

/// Kahn's algorithm, taking the earliest stage that is ready.
fn order(nodes: &[Node]) -> Result<Vec<usize>, usize> {
    let mut readers = vec![Vec::new(); nodes.len()];
    let mut missing: Vec<usize> = nodes.iter().map(|node| node.wires.len()).collect();
    for (at, node) in nodes.iter().enumerate() {
        node.wires
            .iter()
            // Once for each wire: a stage that reads two outputs of another waits for both.
            .for_each(|wire| readers[wire.from].push(at));
    }
    // A sorted set, so that the order in the file decides wherever the wires leave a choice.
    let mut ready: BTreeSet<usize> = (0..nodes.len()).filter(|&at| missing[at] == 0).collect();
    let mut order = Vec::with_capacity(nodes.len());
    while let Some(at) = ready.pop_first() {
        order.push(at);
        for &reader in &readers[at] {
            missing[reader] -= 1;
            if missing[reader] == 0 {
                ready.insert(reader);
            }
        }
    }
    if order.len() == nodes.len() {
        Ok(order)
    } else {
        Err(on_a_circle(nodes, &missing))
    }
}

/// Going upstream from any stage that still waits, one comes to a circle sooner or later.
fn on_a_circle(nodes: &[Node], missing: &[usize]) -> usize {
    let mut at = missing.iter().position(|&missing| missing > 0).unwrap_or(0);
    // As many steps as there are stages: fewer could end on the way to the circle, at a stage that
    // is no part of it.
    for _ in nodes {
        at = nodes[at]
            .wires
            .iter()
            .map(|wire| wire.from)
            .find(|&from| missing[from] > 0)
            .unwrap_or(at);
    }
    at
}
