//! `plan`: says what `run` would do, and why. Writes nothing, but into a cache of the store that
//! there was nothing to do.

use std::mem::ManuallyDrop;
use std::time::SystemTime;

use artifacts_schema::Digest;
use clap::Args;
use serde_json::{Value, json};

use super::options::{Choice, PipelineOptions};
use super::output::{print, print_json, table};
use super::session::Session;
use super::{device, standing};
use crate::error::Error;
use crate::experiment::{Experiment, arm_of};
use crate::explain::Reason;
use crate::pipeline::graph::Node;
use crate::plan::Forecast;
use crate::store::Store;
use crate::store::standing::Standing;

/// Options of `plan`.
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
        let question = standing::question(&self.pipeline, &self.choice, &device);
        let questions: Vec<_> = question
            .iter()
            .flat_map(|run| [*run, standing::of_plan(run)])
            .collect();
        if let Some(found) = standing::find(&questions, &changes.folders.store)? {
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
        let stages: Vec<(&Node, &Forecast)> = forecasts
            .iter()
            .map(|(&at, forecast)| (&nodes[at], forecast))
            .collect();
        let cached = stages
            .iter()
            .filter(|(_, forecast)| matches!(forecast, Forecast::Cached(_)))
            .count();
        let to_run = stages.len() - cached;
        match json {
            true => print_stages(
                &session.graph.pipeline,
                stages
                    .iter()
                    .map(|(node, forecast)| {
                        with_other_names(node, forecast_json(&node.name, forecast))
                    })
                    .collect(),
            ),
            false => self.tell(&session, &stages, cached),
        }
        if let Some(question) = &question {
            standing::Found {
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
    fn tell(&self, session: &Session, stages: &[(&Node, &Forecast)], cached: usize) {
        let rows: Vec<Vec<String>> = stages
            .iter()
            .map(|(node, forecast)| row(&node.title(), forecast))
            .collect();
        print(&table(&rows, false));
        let unique = rows.len();
        let Some(experiment) = &session.graph.experiment else {
            return print(&sum(unique, unique - cached));
        };
        let names = stages.iter().flat_map(|(node, _)| node.names());
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
fn all_cached(standing: &Standing, json: bool) {
    let Standing {
        pipeline, stages, ..
    } = standing;
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

fn cached_row(name: &str, why: &str) -> Vec<String> {
    [name, "cached", why].map(str::to_owned).into()
}

fn cached_json(name: &str, key: &Digest) -> Value {
    json!({"stage": name, "state": "cached", "key": key})
}

fn row(name: &str, forecast: &Forecast) -> Vec<String> {
    let why = match forecast {
        Forecast::Cached(assessment) => {
            return cached_row(
                name,
                if assessment.is_remote {
                    "in the remote"
                } else {
                    ""
                },
            );
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
    vec![name.to_owned(), "will run".to_owned(), why]
}

fn forecast_json(name: &str, forecast: &Forecast) -> Value {
    match forecast {
        Forecast::Cached(assessment) => cached_json(name, &assessment.key),
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
    }
}
