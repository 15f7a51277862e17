//! Properties of every graph: what runs is what changed, no more and no less, and the plan knew it.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::tests::{plan, run};
use crate::pipeline::graph::Graph;
use crate::runner::testing::{graph, node, sum};
use crate::store::runs::End;

/// A stage: its number, what it reduces by, and which of those before it it reads.
type Part = (u32, u32, Vec<usize>);

/// Stages that read up to three of those before them; small numbers, so that different sums are
/// often equal when reduced.
fn parts() -> impl Strategy<Value = Vec<Part>> {
    let part = (
        0u32..6,
        2u32..4,
        prop::collection::vec(any::<prop::sample::Index>(), 0..4),
    );
    prop::collection::vec(part, 2..8).prop_map(|parts| {
        let place = |at: usize, reads: Vec<prop::sample::Index>| match at {
            0 => Vec::new(),
            _ => reads
                .into_iter()
                .take(3)
                .map(|read| read.index(at))
                .collect(),
        };
        parts
            .into_iter()
            .enumerate()
            .map(|(at, (number, modulo, reads))| (number, modulo, place(at, reads)))
            .collect()
    })
}

fn graph_of(parts: &[Part]) -> Graph {
    let nodes = parts
        .iter()
        .enumerate()
        .map(|(at, (number, modulo, reads))| {
            let (_, mut stage) = sum("", *number, reads);
            stage.modulo = *modulo;
            node(&format!("s{at}"), stage, reads)
        });
    graph(nodes.collect())
}

/// What each stage does, and what it comes to: the whole of a stage's recipe, by arithmetic alone.
fn recipes(parts: &[Part]) -> Vec<(Part, Vec<u32>)> {
    let mut values = Vec::new();
    let mut recipes = Vec::new();
    for (number, modulo, reads) in parts {
        let inputs: Vec<u32> = reads.iter().map(|&read| values[read]).collect();
        values.push((number + inputs.iter().sum::<u32>()) % modulo);
        recipes.push(((*number, *modulo, Vec::new()), inputs));
    }
    recipes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 16))]

    #[test]
    fn what_runs_is_what_changed_and_the_plan_knew_it(before in parts(), changed in any::<prop::sample::Index>(), number in 0u32..6) {
        let mut now = before.clone();
        let at = changed.index(now.len());
        now[at].0 = number;
        let folder = tempfile::tempdir().unwrap();
        run(folder.path(), &graph_of(&before), &[], false);
        let graph = graph_of(&now);
        let plan = plan(folder.path(), &graph);
        let ran: BTreeSet<String> = run(folder.path(), &graph, &[], false).ends(&graph, End::Ran).into_iter().collect();
        let old: BTreeSet<_> = recipes(&before).into_iter().collect();
        let mut times: BTreeMap<_, usize> = BTreeMap::new();
        for (at, (recipe, letter)) in recipes(&now).into_iter().zip(plan.chars()).enumerate() {
            let has_run = ran.contains(&format!("s{at}"));
            prop_assert!(letter != 'c' || old.contains(&recipe) && !has_run, "s{at} was planned as cached: {plan}");
            *times.entry(recipe).or_default() += usize::from(has_run);
        }
        // Stages with one recipe have one result: whichever is ready first computes it.
        for (recipe, times) in times {
            prop_assert_eq!(times, usize::from(!old.contains(&recipe)), "{:?}, plan {}", recipe, plan);
        }
    }
}
