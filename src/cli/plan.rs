//! `plan`: says what `run` would do, and why. Writes nothing.

use std::mem::ManuallyDrop;

use clap::Args;
use serde_json::{Value, json};

use super::options::{Choice, PipelineOptions};
use super::output::{print, print_json, table};
use super::session::Session;
use crate::error::Error;
use crate::explain::Reason;
use crate::plan::Forecast;
use crate::store::Store;

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
        // With thousands of stages it takes long to take all this apart, which the end of the process spares.
        let session = ManuallyDrop::new(Session::new(pipeline, changes, &self.choice)?);
        let store = ManuallyDrop::new(Store::open(&changes.folders.store)?);
        let forecasts = ManuallyDrop::new(session.context(&store).forecast()?);
        let stages: Vec<(&str, &Forecast)> =
            forecasts.iter().map(|(&at, forecast)| (session.graph.nodes[at].name.as_str(), forecast)).collect();
        let cached = stages.iter().filter(|(_, forecast)| matches!(forecast, Forecast::Cached(_))).count();
        let (all, to_run) = (stages.len(), stages.len() - cached);
        if json {
            let stages: Vec<Value> = stages.iter().map(|(name, forecast)| forecast_json(name, forecast)).collect();
            print_json(&json!({ "pipeline": session.graph.pipeline, "stages": stages }));
        } else {
            let rows: Vec<Vec<String>> = stages.iter().map(|(name, forecast)| row(name, forecast)).collect();
            print(&table(&rows, false));
            print(&format_args!("\n{all} stages: {cached} cached, {to_run} to run"));
        }
        if self.exit_code && to_run > 0 {
            return Err(Error::Found { message: format!("{to_run} of {all} stages to run"), help: None });
        }
        Ok(())
    }
}

fn row(name: &str, forecast: &Forecast) -> Vec<String> {
    let (state, why) = match forecast {
        Forecast::Cached(assessment) if assessment.is_remote => ("cached", "in the remote".to_owned()),
        Forecast::Cached(_) => ("cached", String::new()),
        Forecast::Run(reason, _) => ("will run", reason.to_string()),
        Forecast::Unless(upstream) => {
            let what = if upstream.len() == 1 { "its result is" } else { "their results are" };
            ("will run", format!("upstream {} will run (spared if {what} unchanged)", upstream.join(", ")))
        }
    };
    vec![name.to_owned(), state.to_owned(), why]
}

fn forecast_json(name: &str, forecast: &Forecast) -> Value {
    match forecast {
        Forecast::Cached(assessment) => json!({"stage": name, "state": "cached", "key": assessment.key}),
        Forecast::Run(reason, _) => {
            let changes = if let Reason::Changed(changes) = reason { json!(changes) } else { Value::Null };
            json!({"stage": name, "state": "will_run", "reason": reason.to_string(), "changes": changes})
        }
        Forecast::Unless(upstream) => json!({"stage": name, "state": "may_be_spared", "upstream": upstream}),
    }
}
