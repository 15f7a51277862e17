//! `store push` and `store pull`: results sent to a remote, or fetched from one, without any
//! pipeline.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use crate::cli::error::Error;
use crate::remote::{Remote, RemoteFault, Traffic};
use crate::store::Store;
use crate::terminal::output::{print, size, tell};

/// Which stores.
#[derive(Args)]
pub struct Transfer {
    /// The remote: s3://BUCKET/FOLDER, gs://.., az://.., file:///FOLDER
    remote: String,
    /// The folder of the store
    #[arg(long, default_value = ".srnerf", value_name = "FOLDER")]
    store: PathBuf,
}

impl Transfer {
    /// Sends every sound result that the remote lacks.
    pub fn push(self, json: bool) -> Result<(), Error> {
        let remote = Remote::open(&self.remote)?;
        let store = Store::open(&self.store)?;
        let traffic = remote.push(&store).map_err(|fault| self.failed(fault))?;
        say("pushed", traffic, json);
        Ok(())
    }

    /// Fetches every sound result that the store lacks.
    pub fn pull(self, json: bool) -> Result<(), Error> {
        let remote = Remote::open(&self.remote)?;
        let store = Store::create(&self.store)?;
        let traffic = remote.pull(&store, &mut |key, what| {
            tell(&format_args!("warning: {key} is left out: {what}"))
        });
        say("pulled", traffic.map_err(|fault| self.failed(fault))?, json);
        Ok(())
    }

    fn failed(&self, fault: RemoteFault) -> Error {
        match fault {
            // A fault of the local store must not be told as the remote's.
            RemoteFault::Local(error) => error.into(),
            fault => Error::Remote {
                address: self.remote.clone(),
                fault,
            },
        }
    }
}

fn say(done: &str, Traffic { results, bytes }: Traffic, json: bool) {
    if json {
        print(&json!({ "event": done, "results": results, "bytes": bytes }));
    } else {
        print(&format_args!("{done} {results} results, {}", size(bytes)));
    }
}
