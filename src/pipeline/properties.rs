//! Properties of pipelines: the order of the file does not matter, and a loop is nothing but its
//! rounds, one after the other.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::graph::Graph;
use super::problem::SourceText;
use super::unroll::round_seed;

/// What tells a stage: its seed, parameters, and what it reads. Not its place.
type Told = (u64, String, Vec<String>);

fn load(text: String) -> BTreeMap<String, Told> {
    let graph = super::load(
        &[SourceText {
            name: "p.ron".into(),
            text: text.into(),
        }],
        &[],
    )
    .unwrap_or_else(|problem| panic!("{problem}"));
    assert!(is_ordered(&graph));
    let wires = |at: usize| {
        graph.nodes[at]
            .wires
            .iter()
            .map(|wire| format!("{}.{}", graph.nodes[wire.from].name, wire.output))
    };
    let told = |at: usize| {
        (
            graph.nodes[at].seed,
            format!("{:?}", params(&graph, at)),
            wires(at).collect(),
        )
    };
    (0..graph.nodes.len())
        .map(|at| (graph.nodes[at].name.clone(), told(at)))
        .collect()
}

/// The parameters without the references.
fn params(graph: &Graph, at: usize) -> BTreeMap<&String, &serde_json::Value> {
    let node = &graph.nodes[at];
    let is_wire = |name: &str| node.wires.iter().any(|wire| wire.input == name);
    node.params
        .as_object()
        .unwrap()
        .iter()
        .filter(|(name, _)| !is_wire(name))
        .collect()
}

/// Each stage comes after those that it reads.
fn is_ordered(graph: &Graph) -> bool {
    graph
        .nodes
        .iter()
        .enumerate()
        .all(|(at, node)| node.wires.iter().all(|wire| wire.from < at))
}

fn pipeline(stages: &[String]) -> String {
    format!(
        r#"(name: "p", seed: 5, stages: {{ "scene": Scene(), {} }})"#,
        stages.join(", ")
    )
}

/// The loop of `count` rounds, each with one stage that enlarges what the round before gave.
fn rounds(count: usize, factors: &[u32]) -> String {
    let mut images = "@x".to_owned();
    let stages = factors.iter().enumerate().map(|(at, factor)| {
        let stage = format!(r#""s{at}": Interpolate(images: "{images}", factor: {factor})"#);
        images = format!("s{at}");
        stage
    });
    let stages = stages.collect::<Vec<_>>().join(", ");
    format!(
        r#""l": Rounds(count: {count}, carry: {{"x": "scene"}}, stages: {{ {stages} }}, next: {{"x": "{images}"}})"#
    )
}

proptest! {
    #[test]
    fn the_order_of_the_file_does_not_matter(reads in prop::collection::vec(any::<prop::sample::Index>(), 1..9), order in any::<u64>()) {
        let name = |at: usize| if at == 0 { "scene".to_owned() } else { format!("s{at}") };
        let stage = |(at, read): (usize, &prop::sample::Index)| {
            format!(r#""s{0}": Interpolate(images: "{1}", factor: {0})"#, at + 1, name(read.index(at + 1)))
        };
        let stages: Vec<String> = reads.iter().enumerate().map(stage).collect();
        let mut shuffled: Vec<(u64, String)> =
            stages.iter().cloned().enumerate().map(|(at, stage)| (round_seed(order, at as u32), stage)).collect();
        shuffled.sort();
        let shuffled: Vec<String> = shuffled.into_iter().map(|(_, stage)| stage).collect();
        prop_assert_eq!(load(pipeline(&stages)), load(pipeline(&shuffled)));
    }

    #[test]
    fn a_loop_begins_as_a_shorter_one_does(count in 1usize..6, factors in prop::collection::vec(1u32..5, 1..4)) {
        let short = load(pipeline(&[rounds(count, &factors)]));
        let long = load(pipeline(&[rounds(count + 1, &factors)]));
        prop_assert_eq!(long.len(), short.len() + factors.len());
        prop_assert!(short.iter().all(|(name, told)| long[name] == *told));
    }

    #[test]
    fn a_loop_is_its_rounds_one_after_the_other(count in 1usize..6, factors in prop::collection::vec(1u32..5, 1..4)) {
        let looped = load(pipeline(&[rounds(count, &factors)]));
        let mut images = "scene".to_owned();
        let mut flat = Vec::new();
        for round in 1..=count {
            for (at, factor) in factors.iter().enumerate() {
                flat.push(format!(r#""l-{round}-s{at}": Interpolate(images: "{images}", factor: {factor})"#));
                images = format!("l-{round}-s{at}");
            }
        }
        for (name, (seed, params, wires)) in load(pipeline(&flat)) {
            let dotted = |name: &str| name.replace('-', ".");
            let (of_loop, params_of_loop, wires_of_loop) = &looped[&dotted(&name)];
            // Only the seed is the round's own.
            let round = name.split('-').nth(1).map_or(seed, |round| round_seed(seed, round.parse().unwrap()));
            prop_assert_eq!((*of_loop, params_of_loop), (round, &params));
            prop_assert_eq!(wires_of_loop.clone(), wires.iter().map(|wire| dotted(wire)).collect::<Vec<_>>());
        }
    }
}
