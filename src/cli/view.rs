//! `view`: fields in a browser on this machine. Writes nothing.

use std::path::{Path, PathBuf};

use artifacts_schema::ImageSet;
use clap::Args;
use nerf::Field;
use serde_json::json;
use stages::convert;

use super::artifact;
use super::device;
use super::diff::find_run;
use super::metrics::last_run;
use super::output::{print, tell};
use crate::error::Error;
use crate::lineage::{Lineage, Told, last_fields};
use crate::store::Store;
use crate::store::runs::Run;
use crate::view::{Server, Subject};

/// Options of `view`.
#[derive(Args)]
pub struct View {
    /// A field (field.safetensors, or the folder that it is in), a run (@2 is the last but one; or
    /// 20261122T23), or a pipeline's name
    #[arg(value_name = "FIELD|RUN", default_value = "@1")]
    what: String,
    /// A field to see beside it; by default the one that its training began with
    beside: Option<PathBuf>,
    /// Of a run with several fields: the stage that made the one to see
    #[arg(long, value_name = "STAGE")]
    stage: Option<String>,
    /// The photos to see beside the field, the folder of an image set; by default those that it was
    /// trained on
    #[arg(long, value_name = "FOLDER")]
    scene: Option<PathBuf>,
    /// The port on this machine's loopback; 0 is any that is free
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Open the page in the browser
    #[arg(long)]
    open: bool,
    /// Where to render: auto, cpu, gpu or gpu:N
    #[arg(long, default_value = "auto")]
    device: String,
    /// The folder of the store
    #[arg(long, default_value = ".srnerf", value_name = "FOLDER")]
    store: PathBuf,
}

impl View {
    /// Serves until it is interrupted.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let device = device::open(&self.device)?;
        let subject = self.subject()?;
        let refuse = |error: std::io::Error| {
            let message = format!("cannot serve on 127.0.0.1:{}: {error}", self.port);
            Error::usage(message, "choose another port: --port, or leave it out")
        };
        let server = Server::new(self.port).map_err(refuse)?;
        let url = server.url();
        if json {
            print(&json!({"url": url, "fields": subject.names(), "photos": subject.photos.len()}));
        } else {
            let fields = subject.names().join(" beside ");
            let photos = subject.photos.len();
            print(&format_args!(
                "{fields}, {photos} photos, on {}\n{url}\nOpen it in a browser; Ctrl-C ends it.",
                device.kind()
            ));
        }
        if self.open {
            open(&url);
        }
        server.run(subject, device).map_err(refuse)
    }

    fn subject(&self) -> Result<Subject, Error> {
        let store = Store::open(&self.store)?;
        let lineage = Lineage::new(&store)?;
        let told = self.told(&store, &lineage)?;
        let beside = match &self.beside {
            Some(path) => Some(read(path)?),
            None => lineage.root(&told)?,
        };
        let photos: Option<ImageSet> = match &self.scene {
            Some(folder) => Some(artifact::images(folder)?),
            None => lineage.photos(&told)?,
        };
        let first = named(told, "field")?;
        let others = beside.map(|told| named(told, "field beside")).transpose()?;
        let photos = photos.map_or(Vec::new(), |set| set.views);
        Ok(Subject::new(first, others.into_iter().collect(), photos))
    }

    fn told(&self, store: &Store, lineage: &Lineage) -> Result<Told, Error> {
        let path = Path::new(&self.what);
        if path.exists() {
            return read(path);
        }
        let run = self.find_run(store)?;
        let fields = last_fields(&run, store)?;
        let chosen = match &self.stage {
            Some(stage) => fields.get(stage),
            None if fields.len() == 1 => fields.values().next(),
            None => None,
        };
        let Some(output) = chosen else {
            let names: Vec<&str> = fields.keys().map(String::as_str).collect();
            let message = format!(
                "the run of {} has {} such fields",
                run.pipeline,
                names.len()
            );
            let help = format!("name one with --stage: {}", names.join(", "));
            return Err(Error::usage(message, help));
        };
        Ok(lineage.field(output)?)
    }

    fn find_run(&self, store: &Store) -> Result<Run, Error> {
        let runs: Vec<Run> = store.runs(None)?.collect();
        if runs.is_empty() {
            return last_run(store, None);
        }
        let of_pipeline = |run: &&Run| run.pipeline == self.what;
        let found = find_run(&runs, &self.what).or_else(|| runs.iter().find(of_pipeline));
        found.cloned().ok_or_else(|| {
            let message = format!("`{}` is no field, no run and no pipeline", self.what);
            let help = "give field.safetensors or its folder, or @1, the last run";
            Error::usage(message, help)
        })
    }
}

fn read(path: &Path) -> Result<Told, Error> {
    let help = "give a field: field.safetensors, or its folder";
    Told::read(path).map_err(|problem| Error::usage(problem, help))
}

/// A field with the name of its stage.
fn named(told: Told, otherwise: &str) -> Result<(String, Field), Error> {
    let stage = told.provenance.stage;
    let name = if stage.is_empty() {
        otherwise.to_owned()
    } else {
        stage
    };
    let help = "was it written by this version of the program?";
    let field =
        convert::field(told.field).map_err(|error| Error::usage(error.to_string(), help))?;
    Ok((name, field))
}

/// Asks the system to show a page; who has no browser opens it by hand.
fn open(url: &str) {
    let program = match std::env::consts::OS {
        "macos" => "open",
        "windows" => "explorer",
        _ => "xdg-open",
    };
    if let Err(error) = std::process::Command::new(program).arg(url).spawn() {
        tell(&format_args!("cannot open a browser ({program}: {error})"));
    }
}
