//! Runs of small graphs: what runs, what is spared, and what happens when a stage does not end
//! well.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use compute::Device;
use stages::Source;

use super::budget::Budget;
use super::{Outcome, Scheduler};
use crate::pipeline::graph::{Graph, Node};
use crate::runner::explain::History;
use crate::runner::plan::{Context, Forecast};
use crate::runner::task::Failure;
use crate::runner::testing::{Act, Sum, graph, node, sum};
use crate::store::Store;
use crate::store::runs::{End, RunRecord, now};
use crate::store::view::View;
use crate::terminal::progress::{Event, Progress};

/// Remembers the reasons of stages that ran; can stop the run at the first word of a stage.
#[derive(Default)]
struct Ear<'c> {
    started: Vec<String>,
    stop: Option<&'c AtomicBool>,
}

impl Progress for Ear<'_> {
    fn event(&mut self, event: &Event) {
        match event {
            Event::Started { stage, reason, .. } => self.started.push(format!("{stage}: {reason}")),
            Event::Said { .. } => self
                .stop
                .iter()
                .for_each(|stop| stop.store(true, Ordering::SeqCst)),
            _ => {}
        }
    }
}

pub(super) struct Done {
    outcome: Outcome,
    started: Vec<String>,
}

impl Done {
    pub(super) fn ends(&self, graph: &Graph, end: End) -> Vec<String> {
        let of_end = self
            .outcome
            .stages
            .iter()
            .filter(|(_, stage)| stage.end == end);
        of_end
            .map(|(&at, _)| graph.nodes[at].name.clone())
            .collect()
    }
}

pub(super) fn run(folder: &Path, graph: &Graph, forced: &[usize], stop: bool) -> Done {
    let store = Store::create(&folder.join("store")).unwrap();
    let context = context(&store, graph, forced);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(2)
        .build()
        .unwrap();
    let view = View::new(&folder.join("out"), "test");
    let cancelled = AtomicBool::new(false);
    let mut ear = Ear {
        started: Vec::new(),
        stop: stop.then_some(&cancelled),
    };
    let scheduler = Scheduler {
        context: &context,
        pool: &pool,
        device: &Device::cpu(),
        view: &view,
        cancelled: &cancelled,
        checkpoint_every: Duration::ZERO,
        budget: Budget {
            threads: 2,
            memory: u64::MAX,
            one_on_device: false,
        },
        fail_fast: false,
    };
    let outcome = scheduler.run(context.cached().unwrap(), &mut ear).unwrap();
    let stages = outcome
        .stages
        .iter()
        .map(|(&at, stage)| (graph.nodes[at].name.clone(), stage.clone()))
        .collect();
    let run = RunRecord {
        pipeline: "test".into(),
        started: now(),
        seconds: 0.0,
        stages,
        experiment: None,
        command: None,
    };
    run.keep(&store).unwrap();
    Done {
        outcome,
        started: ear.started,
    }
}

fn context<'a>(store: &'a Store, graph: &'a Graph, forced: &[usize]) -> Context<'a> {
    Context {
        graph,
        store,
        remote: None,
        device: "cpu",
        fallback: None,
        salt: None,
        forced: forced.iter().copied().collect(),
        needed: (0..graph.nodes.len()).collect(),
        given: BTreeMap::new(),
        history: History::new(store, "test"),
        sources: &NO_SOURCES,
    }
}

/// No stage here reads anything beside its inputs.
static NO_SOURCES: [Vec<Source>; 8] = [const { Vec::new() }; 8];

/// What the plan says of each stage, in its first letter: cached, will run, spared if nothing
/// changes.
pub(super) fn plan(folder: &Path, graph: &Graph) -> String {
    let store = Store::open(&folder.join("store")).unwrap();
    let letter = |forecast: &Forecast| match forecast {
        Forecast::Cached(_) => 'c',
        Forecast::Run(..) => 'w',
        Forecast::Unless(_) => 's',
    };
    context(&store, graph, &[])
        .forecast()
        .unwrap()
        .values()
        .map(letter)
        .collect()
}

/// `a -> b -> d`, `a -> c -> d`.
fn diamond(change: impl Fn(&str, &mut Sum)) -> (Graph, Vec<Sum>) {
    let parts: [(&str, u32, &[usize]); 4] = [
        ("a", 1, &[]),
        ("b", 10, &[0]),
        ("c", 100, &[0]),
        ("d", 5, &[1, 2]),
    ];
    let stages: Vec<(Node, Sum)> = parts
        .iter()
        .map(|(name, number, reads)| {
            let (_, mut stage) = sum(name, *number, reads);
            change(name, &mut stage);
            (node(name, stage.clone(), reads), stage)
        })
        .collect();
    let (nodes, stages): (Vec<_>, Vec<_>) = stages.into_iter().unzip();
    (graph(nodes), stages)
}

fn runs(stages: &[Sum]) -> Vec<usize> {
    stages
        .iter()
        .map(|stage| stage.runs.load(Ordering::SeqCst))
        .collect()
}

#[test]
fn the_second_run_runs_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (graph, stages) = diamond(|_, _| {});
    assert_eq!(plan(folder.path(), &graph), "wwww");
    let done = run(folder.path(), &graph, &[], false);
    assert_eq!(done.started[0], "a: new");
    assert_eq!(plan(folder.path(), &graph), "cccc");
    let done = run(folder.path(), &graph, &[], false);
    assert_eq!(done.ends(&graph, End::Cached), ["a", "b", "c", "d"]);
    assert_eq!(runs(&stages), [1, 1, 1, 1]);
}

#[test]
fn a_changed_parameter_reruns_what_depends_on_it_and_says_why() {
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), &diamond(|_, _| {}).0, &[], false);
    let (graph, stages) = diamond(|name, stage| stage.number += u32::from(name == "c"));
    assert_eq!(plan(folder.path(), &graph), "ccws");
    let done = run(folder.path(), &graph, &[], false);
    assert_eq!(
        done.started,
        [
            "c: params changed: `number` 100 -> 101",
            "d: input `b` (of c) changed"
        ]
    );
    assert_eq!(runs(&stages), [0, 0, 1, 1]);
}

#[test]
fn an_unchanged_result_spares_what_depends_on_it() {
    let folder = tempfile::tempdir().unwrap();
    let modulo = |name: &str, stage: &mut Sum| stage.modulo = if name == "c" { 7 } else { 1000 };
    run(folder.path(), &diamond(modulo).0, &[], false);
    let (graph, stages) = diamond(|name, stage| {
        modulo(name, stage);
        stage.number += 7 * u32::from(name == "c");
    });
    assert_eq!(plan(folder.path(), &graph), "ccws");
    let done = run(folder.path(), &graph, &[], false);
    assert_eq!(done.ends(&graph, End::Cached), ["a", "b", "d"]);
    assert_eq!(runs(&stages), [0, 0, 1, 0]);
}

#[test]
fn a_forced_stage_runs_and_spares_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let (graph, stages) = diamond(|_, _| {});
    run(folder.path(), &graph, &[], false);
    let done = run(folder.path(), &graph, &[0], false);
    assert_eq!(done.started, ["a: forced"]);
    assert_eq!(runs(&stages), [2, 1, 1, 1]);
}

#[test]
fn a_deleted_blob_is_noticed_and_only_its_stage_runs_again() {
    let folder = tempfile::tempdir().unwrap();
    let (graph, stages) = diamond(|_, _| {});
    let first = run(folder.path(), &graph, &[], false).outcome.records;
    let store = Store::open(&folder.path().join("store")).unwrap();
    std::fs::remove_file(store.blobs.path(&first[&1].outputs["sum"].files[0].blob)).unwrap();
    assert_eq!(plan(folder.path(), &graph), "cwcs");
    let done = run(folder.path(), &graph, &[], false);
    assert_eq!(done.started, ["b: blob missing: sum/metrics.json"]);
    assert_eq!(done.outcome.records[&1].outputs, first[&1].outputs);
    assert_eq!(runs(&stages), [1, 2, 1, 1]);
}

#[test]
fn a_failure_stops_what_depends_on_it_and_nothing_else() {
    for (act, words) in [
        (Act::Fail, "these do not fit"),
        (Act::Panic, "internal error: a bug of a test"),
        (Act::Nothing, "cannot be kept"),
        (Act::NoRoom, "the disk is full: free some space"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let (graph, _) =
            diamond(|name, stage| stage.act = if name == "b" { act } else { Act::Well });
        let done = run(folder.path(), &graph, &[], false);
        assert_eq!(done.ends(&graph, End::Ran), ["a", "c"]);
        assert_eq!(done.ends(&graph, End::Failed), ["b"]);
        assert_eq!(done.ends(&graph, End::Stopped), ["d"]);
        let text = done.outcome.failures[0].1.text();
        assert!(text.contains(words), "{text}");
        assert_eq!(
            matches!(done.outcome.failures[0].1, Failure::Bug(_)),
            act == Act::Panic
        );
        let (graph, stages) = diamond(|_, _| {});
        run(folder.path(), &graph, &[], false);
        assert_eq!(runs(&stages), [0, 1, 0, 1]);
    }
}

#[test]
fn a_stopped_run_keeps_what_is_whole_and_goes_on_later() {
    let folder = tempfile::tempdir().unwrap();
    let (graph, _) =
        diamond(|name, stage| stage.act = if name == "c" { Act::Endless } else { Act::Well });
    let done = run(folder.path(), &graph, &[], true);
    assert!(done.outcome.interrupted && done.outcome.failures.is_empty());
    assert!(done.ends(&graph, End::Stopped).contains(&"c".to_owned()));
    assert_eq!(done.outcome.stages.len(), 4);
    let (graph, stages) = diamond(|_, _| {});
    let done = run(folder.path(), &graph, &[], false);
    assert!(!done.outcome.interrupted);
    assert_eq!(
        (runs(&stages)[0], runs(&stages)[2], runs(&stages)[3]),
        (0, 1, 1)
    );
}

#[test]
fn stages_with_one_key_are_computed_once() {
    let folder = tempfile::tempdir().unwrap();
    let stages: Vec<(Node, Sum)> = ["x", "y", "z"].map(|name| sum(name, 3, &[])).into();
    let (nodes, sums): (Vec<_>, Vec<_>) = stages.into_iter().unzip();
    let done = run(folder.path(), &graph(nodes), &[], false);
    assert_eq!(runs(&sums).iter().sum::<usize>(), 1);
    assert_eq!(
        done.outcome
            .records
            .values()
            .map(|record| record.key)
            .collect::<BTreeSet<_>>()
            .len(),
        1
    );
}
