//! `explain`: prints what decides a stage's result, and what is different from an earlier run. Writes nothing.

use std::collections::{BTreeMap, BTreeSet};

use clap::Args;
use serde_json::{Value, json};

use super::options::{Choice, PipelineOptions};
use super::output::{print, print_json, table};
use super::session::Session;
use crate::error::Error;
use crate::explain::{Change, Past, diff};
use crate::plan::{Assessment, Context, Forecast};
use crate::store::Store;

/// Options of `explain`.
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
    now: Option<&'a Assessment>,
    past: Option<Past>,
    changes: Vec<Change>,
    cause: Option<(String, Vec<Change>)>,
}

impl Explain {
    /// Prints the explanation.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let PipelineOptions { pipeline, changes } = &self.pipeline;
        let session = Session::new(pipeline, changes, &Choice::default())?;
        let at = session.stage(&self.stage)?;
        let store = Store::open(&changes.folders.store)?;
        let mut context = session.context(&store);
        context.needed = session.graph.needed(&BTreeSet::from([at]));
        let forecasts = context.forecast()?;
        let Some(account) = account(&context, &forecasts, at)? else { return Ok(()) };
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
    let Some(forecast) = forecasts.get(&at) else { return Ok(None) };
    let now = forecast.assessment();
    let past = match now {
        Some(now) => context.history.nearest_other(name, &now.key, &now.manifest)?,
        None => None,
    };
    let (mut changes, mut cause) = (Vec::new(), None);
    if let (Some(now), Some(past)) = (now, &past) {
        changes = diff(&past.manifest, &now.manifest, &BTreeSet::new());
        context.name_origins(&context.graph.nodes[at], &mut changes);
        cause = first_cause(context, forecasts, &past.started)?;
    }
    Ok(Some(Account { name, forecast, now, past, changes, cause }))
}

/// The first stage upstream that differs from an earlier run by more than its inputs.
fn first_cause(
    context: &Context,
    forecasts: &BTreeMap<usize, Forecast>,
    started: &str,
) -> Result<Option<(String, Vec<Change>)>, Error> {
    for (&at, forecast) in forecasts {
        let name = &context.graph.nodes[at].name;
        let (Some(now), Some(past)) = (forecast.assessment(), context.history.at(started, name)?) else { continue };
        let mut changes = diff(&past.manifest, &now.manifest, &BTreeSet::new());
        changes.retain(|change| change.input().is_none());
        if !changes.is_empty() {
            return Ok(Some((name.clone(), changes)));
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
                format!("it will run after {}, unless that changes nothing", upstream.join(", "))
            }
        }
    }

    fn json(&self) -> Value {
        json!({
            "stage": self.name,
            "state": self.state(),
            "key": self.now.map(|now| now.key),
            "manifest": self.now.map(|now| &now.manifest),
            "compared_with": self.past.as_ref().map(|past| json!({"run": past.started, "key": past.key})),
            "changes": self.changes,
            "first_cause": self.cause.as_ref().map(|(stage, changes)| json!({"stage": stage, "changes": changes})),
        })
    }

    fn print(&self) {
        print(&format_args!("{}: {}", self.name, self.state()));
        let Some(now) = self.now else {
            return print(&"its key is not known before the stages that it reads have run");
        };
        print(&format_args!("key {}\n", now.key));
        let rows: Vec<Vec<String>> =
            now.manifest.0.iter().map(|(path, text)| vec![path.clone(), text.clone()]).collect();
        print(&table(&rows, false));
        let Some(past) = &self.past else { return print(&"\nno earlier run differs") };
        print(&format_args!("\ncompared with the run of {}:", past.started));
        self.changes.iter().for_each(|change| print(&format_args!("  {change}")));
        if let Some((stage, changes)) = self.cause.as_ref().filter(|(stage, _)| stage != self.name) {
            let list: Vec<String> = changes.iter().map(ToString::to_string).collect();
            print(&format_args!("first cause: {stage}: {}", list.join(", ")));
        }
    }
}
