//! `store fsck`: finds damage, names it and puts it out of reach.

use clap::Args;
use serde_json::json;

use crate::cli::error::Error;
use crate::cli::options::Folders;
use crate::store::Store;
use crate::store::fsck::fault::Finding;
use crate::store::fsck::{Report, look_through};
use crate::terminal::output::{print, print_json, size, table};

/// Options of `store fsck`.
#[derive(Args)]
pub struct Fsck {
    /// Only say what is wrong
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    folders: Folders,
}

impl Fsck {
    /// Looks through the store.
    pub fn run(self, json: bool) -> Result<(), Error> {
        // `create` would write into a store that may only be looked at.
        let store = if self.dry_run {
            Store::open
        } else {
            Store::create
        }(&self.folders.store)?;
        let report = look_through(&store, &self.folders.out, !self.dry_run)?;
        let (blobs, bytes) = report.blobs;
        let results = report.results;
        if json {
            print_json(
                &json!({"findings": report.findings, "blobs": blobs, "bytes": bytes, "results": results}),
            );
        } else {
            tell(&report);
        }
        let damage = report
            .findings
            .iter()
            .filter(|finding| finding.fault.is_damage())
            .count();
        if damage == 0 {
            return Ok(());
        }
        let help = if self.dry_run {
            "without --dry-run, fsck puts it out of reach, and the next run computes what is lost"
        } else {
            "the next run computes what is lost"
        };
        Err(Error::Found {
            message: format!("{damage} {} damaged", noun(damage)),
            help: Some(help.into()),
        })
    }
}

fn noun(damage: usize) -> &'static str {
    if damage == 1 { "file is" } else { "files are" }
}

fn tell(report: &Report) {
    let (damage, left): (Vec<_>, Vec<_>) = report
        .findings
        .iter()
        .partition(|finding| finding.fault.is_damage());
    for (title, findings) in [("damaged:", damage), ("left over, and harmless:", left)] {
        if !findings.is_empty() {
            let rows: Vec<Vec<String>> = findings.iter().map(|finding| row(finding)).collect();
            print(&format_args!("{title}\n{}\n", table(&rows, false)));
        }
    }
    let (blobs, bytes) = report.blobs;
    print(&format_args!(
        "sound: {} results, {blobs} blobs, {}",
        report.results,
        size(bytes)
    ));
}

fn row(finding: &Finding) -> Vec<String> {
    let Finding {
        path,
        fault,
        of,
        remedy,
    } = finding;
    let remedy = if fault.is_damage() {
        remedy.to_string()
    } else {
        String::new()
    };
    vec![
        format!("  {path}"),
        fault.to_string(),
        of.clone().unwrap_or_default(),
        remedy,
    ]
}
