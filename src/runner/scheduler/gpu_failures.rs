//! A GPU that fails under a stage: what is said of it, where the stage goes on, and whose the
//! result is then.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use compute::{Device, testing};
use stages::Message;

use super::budget::Budget;
use super::{Outcome, Scheduler};
use crate::pipeline::graph::Graph;
use crate::pipeline::problem::SourceText;
use crate::runner::explain::History;
use crate::runner::plan::{self, Context};
use crate::store::Store;
use crate::store::runs::End;
use crate::store::view::View;
use crate::terminal::progress::{Event, Progress};

const PIPELINE: &str = r#"(
    name: "failures",
    stages: {
        "scene": Scene(source: Procedural(world: "still_life", views: 4, size: (64, 48)), downscale: 4, holdout: 4),
        "fit": Fit(
            images: "scene.train", steps: 60, samples: 256, supersample: 1, field: (levels: 2, march_steps: 16),
        ),
    },
)"#;

/// Listens to a run, and lets something happen to the GPU when `fit` has gone a few steps.
struct Listener<'d> {
    failure: &'d (dyn Fn() + Sync),
    steps: usize,
    heard: Vec<String>,
}

impl Progress for Listener<'_> {
    fn event(&mut self, event: &Event) {
        match event {
            Event::Said {
                stage: "fit",
                message: Message::Progress { .. },
            } => {
                self.steps += 1;
                if self.steps == 3 {
                    (self.failure)();
                }
            }
            Event::Said {
                message: Message::Resumed { step, .. },
                ..
            } => self.heard.push(format!("from step {step}")),
            Event::Warning { stage, text } => self.heard.push(format!("{stage}: {text}")),
            Event::Failed { stage, error, .. } => self.heard.push(format!("{stage}: {error}")),
            _ => {}
        }
    }
}

/// A run on a GPU that counts results which went on on the CPU, or does not.
fn run(
    folder: &Path,
    graph: &Graph,
    device: &Device,
    fallback: bool,
    failure: &(dyn Fn() + Sync),
) -> (Outcome, Vec<String>) {
    let store = Store::create(&folder.join("store")).unwrap();
    let fallen = format!("{}, then cpu", device.kind());
    let needed = (0..graph.nodes.len()).collect();
    let sources = plan::sources(graph, &needed, &store).unwrap();
    let context = Context {
        graph,
        store: &store,
        remote: None,
        device: device.kind(),
        fallback: fallback.then_some(&fallen),
        salt: None,
        forced: Default::default(),
        needed,
        given: BTreeMap::new(),
        history: History::new(&store, "failures"),
        sources: &sources,
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(2)
        .stack_size(16 << 20)
        .build()
        .unwrap();
    let view = View::new(&folder.join("out"), "failures");
    let cancelled = AtomicBool::new(false);
    let mut listener = Listener {
        failure,
        steps: 0,
        heard: Vec::new(),
    };
    let scheduler = Scheduler {
        context: &context,
        pool: &pool,
        device,
        view: &view,
        cancelled: &cancelled,
        checkpoint_every: Duration::ZERO,
        budget: Budget {
            threads: 2,
            memory: u64::MAX,
            one_on_device: true,
        },
        fail_fast: false,
    };
    (
        scheduler
            .run(context.cached().unwrap(), &mut listener)
            .unwrap(),
        listener.heard,
    )
}

fn graph(folder: &Path) -> Graph {
    let path = folder.join("failures.ron");
    std::fs::write(&path, PIPELINE).unwrap();
    crate::pipeline::load(&[SourceText::read(&path).unwrap()], &[]).unwrap()
}

const FIT: usize = 1;

#[test]
fn a_stage_whose_gpu_is_lost_goes_on_from_its_checkpoint_on_the_cpu_and_its_result_has_a_key_of_its_own()
 {
    let Some(device) = testing::gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(folder.path());
    let (outcome, heard) = run(folder.path(), &graph, &device, true, &|| {
        testing::lose(&device)
    });
    assert_eq!(outcome.stages[&FIT].end, End::Ran, "{heard:?}");
    assert!(heard[0].starts_with("fit: the GPU was lost"), "{heard:?}");
    assert!(heard[1].starts_with("from step "), "{heard:?}");
    let record = &outcome.records[&FIT];
    assert_eq!(record.device, format!("{}, then cpu", device.kind()));
    let store = Store::open(&folder.path().join("store")).unwrap();
    assert_eq!(
        store.manifests.get(&record.key).unwrap().0["device"],
        record.device
    );

    // Who takes such results finds it; who does not, computes anew, on a GPU that is there again.
    let device = testing::gpu().unwrap();
    let (again, _) = run(folder.path(), &graph, &device, true, &|| ());
    assert_eq!(
        (again.stages[&FIT].end, again.records[&FIT].key),
        (End::Cached, record.key)
    );
    let (strict, heard) = run(folder.path(), &graph, &device, false, &|| ());
    assert_eq!(strict.stages[&FIT].end, End::Ran, "{heard:?}");
    assert!(strict.records[&FIT].key != record.key && strict.records[&FIT].device == device.kind());
}

#[test]
fn a_stage_whose_gpu_is_full_fails_with_what_to_lower_or_runs_on_the_cpu() {
    let Some(device) = testing::gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let graph = graph(folder.path());
    testing::limit_memory(&device, 1 << 20);
    let (outcome, heard) = run(folder.path(), &graph, &device, false, &|| ());
    assert_eq!(outcome.stages[&FIT].end, End::Failed, "{heard:?}");
    let said = "fit: the GPU's memory is full";
    assert!(
        heard[0].starts_with(said) && heard[0].contains("`log2_table`"),
        "{heard:?}"
    );
    let (outcome, heard) = run(folder.path(), &graph, &device, true, &|| ());
    assert_eq!(outcome.stages[&FIT].end, End::Ran, "{heard:?}");
    assert!(
        heard[0].starts_with(said) && heard[0].contains("going on on the CPU"),
        "{heard:?}"
    );
}
