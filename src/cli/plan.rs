//! `plan`: says what `run` would do, and why. Writes nothing, but into a cache of the store that
//! there was nothing to do.

use std::collections::BTreeMap;
use std::mem::ManuallyDrop;
use std::time::SystemTime;

use artifacts_schema::Digest;
use clap::Args;
use serde_json::{Value, json};

use super::error::Error;
use super::options::{Choice, PipelineOptions};
use super::session::Session;
use super::{device, no_op, takes};
use crate::pipeline::experiment::{Experiment, arm_of};
use crate::pipeline::graph::Node;
use crate::runner::explain::Reason;
use crate::runner::plan::{Context, Cost, Experience, Forecast};
use crate::store::Store;
use crate::store::cache::no_op::UpToDate;
use crate::store::error::StoreError;
use crate::terminal::output::{print, print_json, table};

#[derive(Args)]
pub struct Plan {
    #[command(flatten)]
    pipeline: PipelineOptions,
    #[command(flatten)]
    choice: Choice,
    /// Exit with 5 if there is something to run
    #[arg(long)]
    exit_code: bool,
}

impl Plan {
    /// Prints the plan.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let PipelineOptions { pipeline, changes } = &self.pipeline;
        let device = device::open(&changes.device)?;
        let since = SystemTime::now();
        let question = no_op::question(&self.pipeline, &self.choice, &device);
        // A run that had nothing to do has answered for the plan as well, and looked at more.
        let questions: Vec<_> = question
            .iter()
            .flat_map(|run| [*run, no_op::of_plan(run)])
            .collect();
        if let Some(found) = no_op::find(&questions, &changes.folders.store)? {
            all_cached(&ManuallyDrop::new(found).1, json);
            return Ok(());
        }
        // With thousands of stages it takes long to take all this apart, which the end of the
        // process spares.
        let session = ManuallyDrop::new(Session::on(device, pipeline, changes, &self.choice)?);
        let store = ManuallyDrop::new(Store::open(&changes.folders.store)?);
        let context = ManuallyDrop::new(session.context(&store));
        let forecasts = ManuallyDrop::new(context.forecast()?);
        let nodes = &session.graph.nodes;
        let costs = costs(&context, &forecasts)?;
        let stages: Vec<Planned> = forecasts
            .iter()
            .map(|(at, forecast)| Planned {
                node: &nodes[*at],
                forecast,
                cost: costs.get(at),
            })
            .collect();
        let cached = stages
            .iter()
            .filter(|stage| stage.forecast.is_cached())
            .count();
        let to_run = stages.len() - cached;
        match json {
            true => print_stages(
                &session.graph.pipeline,
                stages
                    .iter()
                    .map(|stage| with_other_names(stage.node, stage.json()))
                    .collect(),
            ),
            false => self.tell(&session, &stages, cached),
        }
        if let Some(question) = &question {
            no_op::Found {
                session: &session,
                context: &context,
                store: &store,
                since,
            }
            .keep_plan(question, &forecasts);
        }
        if self.exit_code && to_run > 0 {
            return Err(Error::Found {
                message: format!("{to_run} of {} stages to run", stages.len()),
                help: None,
            });
        }
        Ok(())
    }
}

impl Plan {
    /// Prints a line for each stage, and their sum.
    fn tell(&self, session: &Session, stages: &[Planned], cached: usize) {
        let rows: Vec<Vec<String>> = stages.iter().map(Planned::row).collect();
        print(&table(&rows, false));
        takes::tell(stages.iter().filter_map(|stage| stage.cost));
        self.tell_sum(session, stages, cached);
    }

    fn tell_sum(&self, session: &Session, stages: &[Planned], cached: usize) {
        let unique = stages.len();
        let Some(experiment) = &session.graph.experiment else {
            return print(&sum(unique, unique - cached));
        };
        let names = stages.iter().flat_map(|stage| stage.node.names());
        // A stage that arms share stands once in the plan, and counts here for each of them.
        let planned = names.filter(|name| self.is_of_chosen_arm(name)).count();
        let size = experiment.size(self.arms(experiment));
        print(&format_args!(
            "\n{size}, {planned} stages, {unique} unique, {cached} cached"
        ));
    }

    /// How many arms are asked for.
    fn arms(&self, experiment: &Experiment) -> usize {
        match self.choice.arm.len() {
            0 => experiment.arms.len(),
            chosen => chosen,
        }
    }

    fn is_of_chosen_arm(&self, stage: &str) -> bool {
        let chosen = &self.choice.arm;
        chosen.is_empty() || arm_of(stage).is_some_and(|arm| chosen.iter().any(|name| name == arm))
    }
}

/// Prints a plan that has nothing to run.
fn all_cached(up_to_date: &UpToDate, json: bool) {
    let UpToDate {
        pipeline, stages, ..
    } = up_to_date;
    match json {
        true => print_stages(
            pipeline,
            stages
                .iter()
                .map(|(name, key)| cached_json(name, key))
                .collect(),
        ),
        false => {
            let rows: Vec<Vec<String>> = stages
                .iter()
                .map(|(name, _)| cached_row(name, ""))
                .collect();
            print(&table(&rows, false));
            print(&sum(rows.len(), 0));
        }
    }
}

fn print_stages(pipeline: &str, stages: Vec<Value>) {
    print_json(&json!({ "pipeline": pipeline, "stages": stages }));
}

fn sum(all: usize, to_run: usize) -> String {
    format!("\n{all} stages: {} cached, {to_run} to run", all - to_run)
}

/// The names that a stage has in other arms.
fn with_other_names(node: &Node, mut stage: Value) -> Value {
    if !node.also.is_empty() {
        stage["also"] = json!(node.also);
    }
    stage
}

fn cached_row(name: &str, place: &str) -> Vec<String> {
    [name, "cached", place].map(str::to_owned).into()
}

fn cached_json(name: &str, key: &Digest) -> Value {
    json!({"stage": name, "state": "cached", "key": key})
}

/// A stage of the plan.
struct Planned<'p> {
    node: &'p Node,
    forecast: &'p Forecast,
    /// What it will take, if it may run.
    cost: Option<&'p Cost>,
}

impl Planned<'_> {
    fn row(&self) -> Vec<String> {
        let name = self.node.title();
        let why = match self.forecast {
            Forecast::Cached(assessment) => {
                let place = if assessment.is_remote {
                    "in the remote"
                } else {
                    ""
                };
                return cached_row(&name, place);
            }
            Forecast::Run(reason, _) => reason.to_string(),
            Forecast::Unless(upstream) => {
                let what = if upstream.len() == 1 {
                    "its result is"
                } else {
                    "their results are"
                };
                format!(
                    "upstream {} will run (spared if {what} unchanged)",
                    upstream.join(", ")
                )
            }
        };
        let takes = self.cost.map(takes::words).unwrap_or_default();
        vec![name, "will run".to_owned(), takes, why]
    }

    fn json(&self) -> Value {
        let name = &self.node.name;
        let stage = match self.forecast {
            Forecast::Cached(assessment) => return cached_json(name, &assessment.key),
            Forecast::Run(reason, _) => {
                let changes = if let Reason::Changed(changes) = reason {
                    json!(changes)
                } else {
                    Value::Null
                };
                json!({"stage": name, "state": "will_run", "reason": reason.to_string(), "changes": changes})
            }
            Forecast::Unless(upstream) => {
                json!({"stage": name, "state": "may_be_spared", "upstream": upstream})
            }
        };
        with_cost(stage, self.cost)
    }
}

fn with_cost(mut stage: Value, cost: Option<&Cost>) -> Value {
    if let Some(cost) = cost {
        stage["expected"] = takes::json(cost);
    }
    stage
}

/// What each stage will take that may run.
fn costs(
    context: &Context,
    forecasts: &BTreeMap<usize, Forecast>,
) -> Result<BTreeMap<usize, Cost>, StoreError> {
    let run = forecasts
        .iter()
        .filter(|(_, forecast)| !forecast.is_cached())
        .map(|(at, _)| *at);
    let run: Vec<usize> = run.collect();
    // Reading what earlier results took means reading thousands of records.
    if run.is_empty() {
        return Ok(BTreeMap::new());
    }
    let experience = Experience::of(context.store)?;
    let record = |at: usize| forecasts.get(&at).and_then(Forecast::record);
    let expected = context.expected(&run, record);
    let costs = run.into_iter();
    Ok(costs
        .map(|at| (at, context.cost(at, &experience, &expected)))
        .collect())
}
