//! `gc`: says which results nobody needs any more, and removes them if told to.

use std::time::Duration;

use clap::Args;
use serde_json::json;

use super::error::Error;
use super::options::{self, Folders};
use crate::store::Store;
use crate::store::gc::{Doomed, Garbage, Policy, Why};
use crate::terminal::output::{print, print_json, size, table};

#[derive(Args)]
pub struct Gc {
    /// Keep what the last runs of each pipeline used: how many
    #[arg(long, value_name = "N", default_value_t = 16)]
    keep_last: usize,
    /// Keep what was used within this time: 12h, 30d
    #[arg(long, value_name = "TIME", default_value = "0", value_parser = options::time)]
    older_than: Duration,
    /// Then remove what was not used for longest, until results take no more than this: 500MB, 20GB
    #[arg(long, value_name = "SIZE", value_parser = options::size)]
    max_size: Option<u64>,
    /// Remove it; without this, gc only says what would go
    #[arg(long, visible_alias = "yes")]
    delete: bool,
    #[command(flatten)]
    folders: Folders,
}

impl Gc {
    /// Says what goes, and removes it.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let Self {
            keep_last,
            older_than,
            max_size,
            delete,
            folders,
        } = self;
        let mut store = Store::open(&folders.store)?;
        let _alone = if delete { Some(store.alone()?) } else { None };
        // With the store to itself if anything is to go: a run could take up again what is listed
        // here.
        let policy = Policy {
            keep_last,
            older_than,
            max_size,
        };
        let garbage = Garbage::of(&store, &policy)?;
        if delete {
            garbage.remove(&store)?;
        }
        if json {
            let others: Vec<String> = garbage
                .others
                .iter()
                .map(|path| path.display().to_string())
                .collect();
            print_json(&json!({
                "results": garbage.results, "blobs": garbage.blobs.len(), "bytes": garbage.bytes(), "others": others,
                "stays": garbage.stays, "deleted": delete,
            }));
        } else {
            tell(&garbage, delete);
        }
        match max_size {
            // Only a limit of size can be missed: what the other options ask for, `gc` can do.
            Some(most) if garbage.stays > most => Err(Error::Found {
                message: format!("{} stay, more than {}", size(garbage.stays), size(most)),
                help: Some(
                    "the last run of each pipeline and pins are never removed: see `pin`".into(),
                ),
            }),
            _ => Ok(()),
        }
    }
}

fn tell(garbage: &Garbage, deleted: bool) {
    if !garbage.results.is_empty() {
        let head = ["stage", "size", "last used by", "at", "key", "why"]
            .map(str::to_owned)
            .to_vec();
        let rows: Vec<Vec<String>> = std::iter::once(head)
            .chain(garbage.results.iter().map(row))
            .collect();
        print(&format_args!("{}\n", table(&rows, false)));
    }
    let (verb, more) = match (deleted, garbage.is_empty()) {
        (true, _) => ("went", ""),
        (false, true) => ("would go", ""),
        (false, false) => ("would go", "; gc --delete removes them"),
    };
    let results = garbage.results.len();
    let blobs = garbage.blobs.len();
    let others = garbage.others.len();
    let bytes = size(garbage.bytes());
    let stays = size(garbage.stays);
    print(&format_args!(
        "{results} results, {blobs} blobs ({bytes}) and {others} other files {verb}, {stays} stay{more}"
    ));
}

fn row(doomed: &Doomed) -> Vec<String> {
    let unknown = || "-".to_owned();
    let why = match doomed.why {
        Why::Unused => "no run kept and no pin needs it",
        Why::TooLarge => "the store is too large",
    };
    vec![
        doomed.stage.clone(),
        size(doomed.bytes),
        doomed.pipeline.clone().unwrap_or_else(unknown),
        doomed.used.clone().unwrap_or_else(unknown),
        doomed.key.to_string()[..12].to_owned(),
        why.to_owned(),
    ]
}
