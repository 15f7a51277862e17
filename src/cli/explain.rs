//! `explain`: prints what decides a stage's result, and what is different from an earlier run.
//! Writes nothing.

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;
use clap::Args;
use serde_json::{Value, json};

use super::error::Error;
use super::options::{Choice, PipelineOptions};
use super::session::Session;
use crate::runner::explain::{Change, Past, diff};
use crate::runner::plan::{Context, Forecast};
use crate::store::Store;
use crate::store::manifest::Manifest;
use crate::terminal::output::{print, print_json, table};

#[derive(Args)]
pub struct Explain {
    /// The stage: fit, or i3ds.2.optimize
    stage: String,
    #[command(flatten)]
    pipeline: PipelineOptions,
}

/// What is known of a stage.
struct Account<'a> {
    name: &'a str,
    forecast: &'a Forecast,
    /// Its key and manifest; without a key where inputs are not known yet.
    now: Option<(Digest, Manifest)>,
    past: Option<Past>,
    changes: Vec<Change>,
    /// The first stage upstream that is not as it was, and how.
    cause: Option<(String, String)>,
}

impl Explain {
    /// Prints the explanation.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let PipelineOptions { pipeline, changes } = &self.pipeline;
        let session = Session::new(pipeline, changes, &Choice::default())?;
        let at = session.stage(&self.stage)?;
        let store = Store::open(&changes.folders.store)?;
        let mut context = session.context(&store);
        // Only what its key depends on: the results of other stages need not be looked up.
        context.needed = session.graph.needed(&BTreeSet::from([at]));
        let forecasts = context.forecast()?;
        let Some(account) = account(&context, &forecasts, at)? else {
            return Ok(());
        };
        if json {
            print_json(&account.json())
        } else {
            account.print()
        }
        Ok(())
    }
}

fn account<'a>(
    context: &'a Context,
    forecasts: &'a BTreeMap<usize, Forecast>,
    at: usize,
) -> Result<Option<Account<'a>>, Error> {
    let name = &context.graph.nodes[at].name;
    let Some(forecast) = forecasts.get(&at) else {
        return Ok(None);
    };
    let now = forecast
        .assessment()
        .map(|now| (now.key, context.manifest_of(at, &now.inputs, &now.key)));
    let past = match &now {
        Some((key, manifest)) => context.history.nearest_other(name, key, manifest)?,
        None => None,
    };
    let mut changes = Vec::new();
    // What will run serves where the key is unknown or no earlier run differs. A difference from
    // such a run tells more.
    let mut cause = first_to_run(context, forecasts);
    if let (Some((_, manifest)), Some(past)) = (&now, &past) {
        changes = diff(&past.manifest, manifest, &BTreeSet::new());
        context.name_origins(&context.graph.nodes[at], &mut changes);
        cause = first_cause(context, forecasts, &past.started)?.or(cause);
    }
    // Where a stage is its own cause, its state and its changes say so already.
    cause = cause.filter(|(stage, _)| stage != name);
    Ok(Some(Account {
        name,
        forecast,
        now,
        past,
        changes,
        cause,
    }))
}

/// The first stage that will run for a reason of its own.
fn first_to_run(
    context: &Context,
    forecasts: &BTreeMap<usize, Forecast>,
) -> Option<(String, String)> {
    forecasts.iter().find_map(|(&at, forecast)| match forecast {
        Forecast::Run(reason, _) => {
            Some((context.graph.nodes[at].name.clone(), reason.to_string()))
        }
        _ => None,
    })
}

/// The first stage upstream that differs from an earlier run by more than its inputs.
fn first_cause(
    context: &Context,
    forecasts: &BTreeMap<usize, Forecast>,
    started: &str,
) -> Result<Option<(String, String)>, Error> {
    for (&at, forecast) in forecasts {
        let name = &context.graph.nodes[at].name;
        let (Some(now), Some(past)) = (forecast.assessment(), context.history.at(started, name)?)
        else {
            continue;
        };
        let manifest = context.manifest_of(at, &now.inputs, &now.key);
        let mut changes = diff(&past.manifest, &manifest, &BTreeSet::new());
        // A changed input only passes on what changed before it. The cause lies where something
        // else changed.
        changes.retain(|change| change.input().is_none());
        if !changes.is_empty() {
            return Ok(Some((
                name.clone(),
                changes
                    .iter()
                    .map(ToString::to_string)
                    .collect::<Vec<_>>()
                    .join(", "),
            )));
        }
    }
    Ok(None)
}

impl Account<'_> {
    fn state(&self) -> String {
        match self.forecast {
            Forecast::Cached(_) => "its result is in the store".into(),
            Forecast::Run(reason, _) => format!("it will run: {reason}"),
            Forecast::Unless(upstream) => {
                format!(
                    "it will run after {}, unless that changes nothing",
                    upstream.join(", ")
                )
            }
        }
    }

    fn json(&self) -> Value {
        json!({
            "stage": self.name,
            "state": self.state(),
            "key": self.now.as_ref().map(|(key, _)| key),
            "manifest": self.now.as_ref().map(|(_, manifest)| manifest),
            "compared_with": self.past.as_ref().map(|past| json!({"run": past.started, "key": past.key})),
            "changes": self.changes,
            "first_cause": self.cause.as_ref().map(|(stage, why)| json!({"stage": stage, "why": why})),
        })
    }

    fn print(&self) {
        print(&format_args!("{}: {}", self.name, self.state()));
        match &self.now {
            Some((key, manifest)) => self.print_key(key, manifest),
            None => print(&"its key is not known before the stages that it reads have run"),
        }
        if let Some((stage, why)) = &self.cause {
            print(&format_args!("first cause: {stage}: {why}"));
        }
    }

    fn print_key(&self, key: &Digest, manifest: &Manifest) {
        print(&format_args!("key {key}\n"));
        let rows: Vec<Vec<String>> = manifest
            .0
            .iter()
            .map(|(path, text)| vec![path.clone(), text.clone()])
            .collect();
        print(&table(&rows, false));
        let Some(past) = &self.past else {
            return print(&"\nno earlier run differs");
        };
        print(&format_args!(
            "\ncompared with the run of {}:",
            past.started
        ));
        self.changes
            .iter()
            .for_each(|change| print(&format_args!("  {change}")));
    }
}
