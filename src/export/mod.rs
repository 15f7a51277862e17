//! A pipeline as jobs for somebody else's scheduler: one for each stage, one array for the shards
//! of a stage.
//!
//! Every job is a call of `run --only`, which owns keys, store and checkpoints; the scheduler only
//! orders processes. Each way of writing the jobs down is a file.

pub mod ffmpeg;
pub mod quote;
pub mod slurm;
pub mod snakemake;
pub mod tensorboard;
pub mod webp;

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;

use crate::pipeline::graph::Node;
use crate::runner::key::Recipe;
use crate::runner::plan::{Context, Expected, Inputs};

/// A pipeline as jobs.
pub struct Workflow {
    /// The pipeline's name.
    pub pipeline: String,
    /// The program and its arguments up to those that choose a stage.
    pub command: Vec<String>,
    /// The jobs, each after those that it needs.
    pub jobs: Vec<Job>,
}

/// One stage, or all shards of one.
pub struct Job {
    /// The stage; of shards: what stands before their numbers.
    pub stage: String,
    /// Of shards: how many there are.
    pub shards: Option<usize>,
    /// What decides each shard's result beside its inputs. It changes when a parameter does, and
    /// not with what was computed.
    pub recipes: Vec<Digest>,
    /// The jobs whose results it reads, by place.
    pub needs: BTreeSet<usize>,
    /// What to ask of the scheduler.
    pub resources: Resources,
}

/// What a job takes, rounded up to what schedulers count in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resources {
    /// Cores.
    pub threads: u32,
    /// Main memory in MiB.
    pub memory: u64,
    /// Minutes, with room for slower machines: what is cut off goes on where it stopped.
    pub minutes: u64,
}

/// Twice what is estimated, since nobody likes to be cut off.
const ROOM: f64 = 2.0;

/// The least that a job asks for.
const LEAST: Resources = Resources {
    threads: 2,
    memory: 512,
    minutes: 10,
};

impl Workflow {
    /// The jobs of the stages that are needed; `command` is the program with its arguments up to
    /// those that choose a stage.
    pub fn new(context: &Context, command: Vec<String>) -> Self {
        let nodes = &context.graph.nodes;
        let needed: Vec<usize> = context.needed.iter().copied().collect();
        // Of no result, so that the jobs are the same whatever has been computed.
        let expected = context.expected(&needed, |_| None);
        let mut jobs: Vec<Job> = Vec::new();
        let mut job_of = BTreeMap::new();
        for &at in &context.needed {
            let node = &nodes[at];
            let array = shard_of(nodes, at);
            // Shards follow one another in the graph, so the last job is that of the first shard.
            if let (Some((whole, 2..)), Some(job)) = (array, jobs.last_mut()) {
                job.recipes.push(recipe(context, at));
                job.resources = job.resources.most(Resources::of(node, &expected));
                debug_assert_eq!(job.stage, whole);
            } else {
                jobs.push(Job {
                    stage: array
                        .map_or(node.name.as_str(), |(whole, _)| whole)
                        .to_owned(),
                    shards: None,
                    recipes: vec![recipe(context, at)],
                    // What a stage reads is needed as well and stands before it, so its job is
                    // there.
                    needs: node.wires.iter().map(|wire| job_of[&wire.from]).collect(),
                    resources: Resources::of(node, &expected),
                });
            }
            if let (Some(job), Some((_, number))) = (jobs.last_mut(), array) {
                job.shards = Some(number);
            }
            job_of.insert(at, jobs.len() - 1);
        }
        Self {
            pipeline: context.graph.pipeline.clone(),
            command,
            jobs,
        }
    }

    /// The jobs that no other needs, by place.
    pub fn last(&self) -> BTreeSet<usize> {
        let needed: BTreeSet<usize> = self
            .jobs
            .iter()
            .flat_map(|job| job.needs.iter().copied())
            .collect();
        (0..self.jobs.len())
            .filter(|at| !needed.contains(at))
            .collect()
    }
}

/// Of a shard: the stage that it is of, and its number from 1.
fn shard_of(nodes: &[Node], at: usize) -> Option<(&str, usize)> {
    let (whole, number) = nodes[at].name.rsplit_once('.')?;
    let merge = nodes[at..]
        .iter()
        .find(|node| node.name == whole && node.stage.kind() == "Merge")?;
    merge
        .wires
        .iter()
        .any(|wire| wire.from == at)
        .then_some((whole, number.parse().ok()?))
}

fn recipe(context: &Context, at: usize) -> Digest {
    let node = &context.graph.nodes[at];
    // Without inputs, whose digests change with every result: stamps already tell Snakemake of
    // those.
    let sources = &context.sources[at];
    Recipe {
        node,
        inputs: &Inputs::new(),
        sources,
        device: context.device,
        salt: context.salt,
    }
    .key()
}

impl Resources {
    fn of(node: &Node, expected: &Expected) -> Self {
        let estimate = node.stage.estimate(&expected.of_inputs(node));
        let asked = Self {
            threads: LEAST.threads,
            memory: (estimate.memory as f64 * ROOM / f64::from(1 << 20)).ceil() as u64,
            // Rounded up: an hour and a second must not be cut off after the hour.
            minutes: (estimate.seconds * ROOM / 60.0).ceil() as u64,
        };
        asked.most(LEAST)
    }

    fn most(self, other: Self) -> Self {
        Self {
            threads: self.threads.max(other.threads),
            memory: self.memory.max(other.memory),
            minutes: self.minutes.max(other.minutes),
        }
    }
}
