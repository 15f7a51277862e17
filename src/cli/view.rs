//! `view`: fields in a browser on this machine. Writes nothing.

use std::path::PathBuf;

use artifacts_schema::ImageSet;
use clap::Args;
use nerf::Field;
use serde_json::json;
use stages::convert;

use super::artifact;
use super::device;
use super::error::Error;
use super::named;
use crate::content::lineage::{Lineage, Told};
use crate::store::Store;
use crate::terminal::output::{print, tell};
use crate::view::{Server, Subject};

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
            // The server listens by now: what a browser asks for waits until it is served.
            open(&url);
        }
        server.run(subject, device).map_err(refuse)
    }

    fn subject(&self) -> Result<Subject, Error> {
        let store = Store::open(&self.store)?;
        let lineage = Lineage::new(&store)?;
        let told = named::field(&self.what, self.stage.as_deref(), &store, &lineage)?;
        let beside = match &self.beside {
            Some(path) => Some(named::read(path)?),
            None => lineage.root(&told)?,
        };
        let photos: Option<ImageSet> = match &self.scene {
            Some(folder) => Some(artifact::images(folder)?),
            None => lineage.photos(&told)?,
        };
        let first = with_name(told, "field")?;
        let others = beside
            .map(|told| with_name(told, "field beside"))
            .transpose()?;
        // A field can be looked at without any photo: a camera is then placed by its box.
        let photos = photos.map_or(Vec::new(), |set| set.views);
        Ok(Subject::new(first, others.into_iter().collect(), photos))
    }
}

/// A field with the name of its stage.
fn with_name(told: Told, otherwise: &str) -> Result<(String, Field), Error> {
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
    // Not waited for: some of these end only with the browser.
    if let Err(error) = std::process::Command::new(program).arg(url).spawn() {
        tell(&format_args!("cannot open a browser ({program}: {error})"));
    }
}
