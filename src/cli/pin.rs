//! `pin` and `unpin`: results that `gc` never removes.

use clap::Args;
use serde_json::json;

use super::error::Error;
use super::options::Folders;
use crate::store::Store;
use crate::store::pins::Pin as Kept;
use crate::store::runs::RunRecord;
use crate::terminal::output::{print, print_json, table};

#[derive(Args)]
pub struct Pin {
    /// A name for it; without one, all pins are listed
    name: Option<String>,
    /// Only these stages of the run
    stages: Vec<String>,
    /// The run: @2 is the last but one, or the beginning of when it began
    #[arg(long, default_value = "@1")]
    run: String,
    #[command(flatten)]
    folders: Folders,
}

#[derive(Args)]
pub struct Unpin {
    /// The pin's name
    name: String,
    #[command(flatten)]
    folders: Folders,
}

impl Pin {
    /// Pins the results of a run, or lists all pins.
    pub fn run(self, json: bool) -> Result<(), Error> {
        match &self.name {
            Some(name) => self.pin(name, json),
            None => list(&Store::open(&self.folders.store)?, json),
        }
    }

    fn pin(&self, name: &str, json: bool) -> Result<(), Error> {
        check(name)?;
        let store = Store::create(&self.folders.store)?;
        let runs: Vec<_> = RunRecord::past(&store, None)?.collect();
        let Some(run) = super::diff::find_run(&runs, &self.run) else {
            return Err(Error::usage(
                format!("there is no run `{}` to pin", self.run),
                "run a pipeline first",
            ));
        };
        let within =
            // With the dot, so that `fit` does not mean `fit_long` as well.
            |stage: &str, name: &String| stage == name || stage.starts_with(&format!("{name}."));
        let wanted = |stage: &str| {
            self.stages.is_empty() || self.stages.iter().any(|name| within(stage, name))
        };
        let pin = Kept::new(name, run, wanted);
        if pin.keys.is_empty() {
            return Err(Error::usage(
                "none of these stages is in the run",
                "pin without stages pins all of them",
            ));
        }
        pin.keep(&store)?;
        if json {
            print_json(&json!(pin));
        } else {
            print(&format_args!(
                "{name}: {} results of {} at {}",
                pin.keys.len(),
                pin.pipeline,
                pin.started
            ));
        }
        Ok(())
    }
}

impl Unpin {
    /// Removes a pin.
    pub fn run(self) -> Result<(), Error> {
        check(&self.name)?;
        if Kept::remove(&Store::create(&self.folders.store)?, &self.name)? {
            return Ok(());
        }
        Err(Error::usage(
            format!("there is no pin `{}`", self.name),
            "`pin` without a name lists all pins",
        ))
    }
}

/// A pin's name becomes that of a file: it must not lead out of the pins' folder.
fn check(name: &str) -> Result<(), Error> {
    let good = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    if name.starts_with('.') || !name.chars().all(good) || !(1..=64).contains(&name.len()) {
        let help = "names are letters, digits, `_`, `-` and `.`";
        return Err(Error::usage(format!("`{name}` cannot name a pin"), help));
    }
    Ok(())
}

fn list(store: &Store, json: bool) -> Result<(), Error> {
    let pins = Kept::all(store)?;
    if json {
        print_json(&json!({ "pins": pins }));
    } else if pins.is_empty() {
        print(&"no pins");
    } else {
        let row = |pin: &Kept| {
            vec![
                pin.name.clone(),
                format!("{} results", pin.keys.len()),
                pin.pipeline.clone(),
                pin.started.clone(),
            ]
        };
        print(&table(&pins.iter().map(row).collect::<Vec<_>>(), false));
    }
    Ok(())
}
