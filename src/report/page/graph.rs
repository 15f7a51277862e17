//! The results of a run as a graph: which was made from which, and where each stands in a drawing.
//! Knows results by their keys and what they hold by digests; `drawing.rs` makes the SVG.

mod drawing;

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;

use crate::pipeline::experiment::arm_of;
use crate::store::Store;
use crate::store::error::StoreError;
use crate::store::record::Record;
use crate::store::runs::{End, RunRecord, StageRun};

/// Results that are drawn at most: of more, the table of stages tells more than lines do.
const MOST: usize = 400;
/// In a manifest, what comes before the name of an input.
const INPUT: &str = "inputs.";

/// The results of a run. Each comes behind those that it was made from.
pub struct ProvenanceGraph {
    nodes: Vec<Node>,
}

/// A result: a box of the drawing.
#[derive(Clone, Debug, PartialEq)]
struct Node {
    /// The stage's name without its arm.
    stage: String,
    /// The arms that it is of, in the order of their names.
    arms: Vec<String>,
    end: End,
    reason: Option<String>,
    /// What it took when it was computed, if it has a result.
    cost: Option<(f64, Option<u64>)>,
    /// The nodes that it was made from, without those that another of them was made from.
    parents: Vec<usize>,
    /// One more than the furthest of its parents'.
    column: usize,
    /// Free in its column, and as near to its first parent's as that allows.
    row: usize,
}

impl ProvenanceGraph {
    /// The graph of a run; `None` where it has no results or too many to draw.
    pub fn of(run: &RunRecord, store: &Store) -> Result<Option<Self>, StoreError> {
        let results = results(run, store)?;
        if results.is_empty() || results.len() > MOST {
            return Ok(None);
        }
        let mut nodes = nodes(&results, store);
        reduce(&mut nodes);
        place(&mut nodes);
        Ok(Some(Self { nodes }))
    }
}

/// What a run left under one key, whatever number of names it has there.
struct Found<'r> {
    key: Digest,
    names: Vec<&'r str>,
    run: &'r StageRun,
    record: Option<Record>,
}

/// The results of a run by the first of their names.
fn results<'r>(run: &'r RunRecord, store: &Store) -> Result<Vec<Found<'r>>, StoreError> {
    let mut places: BTreeMap<Digest, usize> = BTreeMap::new();
    let mut results: Vec<Found> = Vec::new();
    for (name, stage) in &run.stages {
        // A stage that never began has no key where what comes before it failed.
        let Some(key) = stage.key else { continue };
        let at = *places.entry(key).or_insert(results.len());
        if at == results.len() {
            results.push(Found {
                key,
                names: Vec::new(),
                run: stage,
                record: store.results.lookup(&key)?.sound(),
            });
        }
        results[at].names.push(name);
    }
    Ok(results)
}

/// For each result, those that it was made from: where an input has the digest of an output.
fn parents(results: &[Found], store: &Store) -> Vec<Vec<usize>> {
    let mut makers: BTreeMap<String, usize> = BTreeMap::new();
    for (at, found) in results.iter().enumerate() {
        let outputs = found.record.iter().flat_map(|record| &record.outputs);
        for (_, output) in outputs {
            // Of several results with the same content the first stands for all.
            makers.entry(output.digest.to_string()).or_insert(at);
        }
    }
    let made_from = |found: &Found| {
        let manifest = store.manifests.get(&found.key).unwrap_or_default();
        let entries = manifest.0.iter();
        entries
            .filter(|(path, _)| path.starts_with(INPUT))
            .filter_map(|(_, digest)| makers.get(digest).copied())
            .collect()
    };
    results.iter().map(made_from).collect()
}

/// The nodes of results, each behind its parents.
fn nodes(results: &[Found], store: &Store) -> Vec<Node> {
    let parents = parents(results, store);
    let order = order(&parents);
    let mut places = vec![0; results.len()];
    for (place, &at) in order.iter().enumerate() {
        places[at] = place;
    }
    let node = |&at: &usize| {
        // Two stages can give the same bytes, so that a result may seem to be made from a later
        // one. Such a line is left out.
        let mut before: Vec<usize> = parents[at].iter().map(|&parent| places[parent]).collect();
        before.retain(|&parent| parent < places[at]);
        before.sort_unstable();
        before.dedup();
        Node::of(&results[at], before)
    };
    order.iter().map(node).collect()
}

impl Node {
    fn of(found: &Found, parents: Vec<usize>) -> Self {
        let name = found.names[0];
        let record = found.record.as_ref();
        Self {
            stage: name.rsplit('/').next().unwrap_or(name).to_owned(),
            arms: arms(&found.names),
            end: found.run.end,
            reason: found.run.reason.clone(),
            cost: record.map(|record| (record.seconds, record.peak_memory)),
            parents,
            column: 0,
            row: 0,
        }
    }
}

/// The arms of stages' names, each once.
fn arms(names: &[&str]) -> Vec<String> {
    let mut arms: Vec<String> = names
        .iter()
        .filter_map(|name| arm_of(name))
        .map(str::to_owned)
        .collect();
    // Names come in order, so those of one arm follow one another.
    arms.dedup();
    arms
}

/// All indices, each behind its parents. In a circle one of them has to come before its parent.
fn order(parents: &[Vec<usize>]) -> Vec<usize> {
    let mut order = Vec::new();
    let mut begun = vec![false; parents.len()];
    // By hand and not by recursion: a chain may be as long as the graph.
    for first in 0..parents.len() {
        // Each comes twice: first to put its parents before it, then to be put down itself.
        let mut open = vec![(first, false)];
        while let Some((at, done)) = open.pop() {
            if done {
                order.push(at);
            } else if !std::mem::replace(&mut begun[at], true) {
                open.push((at, true));
                open.extend(parents[at].iter().rev().map(|&parent| (parent, false)));
            }
        }
    }
    order
}

/// Drops the parents that others imply: photos go into almost every stage, and a line for each
/// would hide the rest. Nodes come behind their parents.
fn reduce(nodes: &mut [Node]) {
    let mut ancestors: Vec<BTreeSet<usize>> = Vec::new();
    for node in nodes {
        let further = node.parents.iter().flat_map(|&parent| &ancestors[parent]);
        let further: BTreeSet<usize> = further.copied().collect();
        // Before any parent is dropped: what follows from a dropped one follows from this node too.
        let all = further.iter().chain(&node.parents).copied().collect();
        ancestors.push(all);
        node.parents.retain(|parent| !further.contains(parent));
    }
}

/// Gives nodes their places. They come behind their parents.
fn place(nodes: &mut [Node]) {
    let mut taken: Vec<Vec<bool>> = Vec::new();
    for at in 0..nodes.len() {
        let parents = &nodes[at].parents;
        let column = parents.iter().map(|&parent| nodes[parent].column + 1).max();
        let column = column.unwrap_or(0);
        // The nearest of its parents decides: chains of stages stay on one line.
        let near = parents.iter().max_by_key(|&&parent| nodes[parent].column);
        let wanted = near.map_or(0, |&parent| nodes[parent].row);
        taken.resize_with(taken.len().max(column + 1), Vec::new);
        let rows = &mut taken[column];
        let row = (wanted..).find(|&row| !rows.get(row).is_some_and(|&taken| taken));
        let row = row.unwrap_or(wanted);
        rows.resize(rows.len().max(row + 1), false);
        rows[row] = true;
        nodes[at].column = column;
        nodes[at].row = row;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(parents: &[&[usize]]) -> Vec<Node> {
        let node = |parents: &&[usize]| Node {
            stage: "fit".to_owned(),
            arms: vec!["ours".to_owned()],
            end: End::Ran,
            reason: None,
            cost: Some((12.0, None)),
            parents: parents.to_vec(),
            column: 0,
            row: 0,
        };
        let mut nodes: Vec<Node> = parents.iter().map(node).collect();
        reduce(&mut nodes);
        place(&mut nodes);
        nodes
    }

    fn places(nodes: &[Node]) -> Vec<[usize; 2]> {
        nodes.iter().map(|node| [node.column, node.row]).collect()
    }

    #[test]
    fn a_chain_lies_on_one_line_and_a_branch_below_it() {
        let nodes = graph(&[&[], &[0], &[1], &[0], &[3, 2]]);
        assert_eq!(places(&nodes), [[0, 0], [1, 0], [2, 0], [1, 1], [3, 0]]);
    }

    #[test]
    fn results_come_behind_what_they_were_made_from() {
        assert_eq!(order(&[vec![2], vec![0], vec![]]), [2, 0, 1]);
    }

    #[test]
    fn what_seems_to_be_a_circle_has_an_order_too() {
        assert_eq!(order(&[vec![1], vec![0], vec![2]]), [1, 0, 2]);
    }

    #[test]
    fn arms_that_share_a_result_are_named_once() {
        let names = ["ours/seed_0/fit", "ours/seed_1/fit", "rsd/seed_0/fit"];
        assert_eq!(arms(&names), ["ours", "rsd"]);
        assert!(arms(&["fit"]).is_empty());
    }

    #[test]
    fn a_drawing_has_a_box_for_each_result_and_lines_that_others_do_not_imply() {
        let mut nodes = graph(&[&[], &[0], &[0, 1]]);
        nodes[1].reason = Some("a \"new\" stage".to_owned());
        nodes[2].cost = None;
        nodes[2].end = End::Failed;
        let svg = ProvenanceGraph { nodes }.svg();
        assert_eq!(svg.matches("<rect").count(), 3);
        assert_eq!(svg.matches("<path").count(), 2);
        assert!(
            svg.contains("ours: ran. Why: a &quot;new&quot; stage"),
            "{svg}"
        );
        assert!(svg.contains("class=\"failed\""), "{svg}");
    }
}
