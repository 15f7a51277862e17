//! `report`: writes the comparison of the last run's arms as one HTML file.

use std::path::PathBuf;

use clap::Args;

use super::error::Error;
use super::metrics::last_run;
use super::options::Folders;
use crate::report::comparison::Comparison;
use crate::report::page::{Gallery, Page};
use crate::store::Store;
use crate::terminal::output::{print, size};

#[derive(Args)]
pub struct Report {
    /// The pipeline's name, or its file; by default that of the last run
    pipeline: Option<String>,
    /// The file to write
    #[arg(short, long, value_name = "FILE", default_value = "report.html")]
    output: PathBuf,
    #[command(flatten)]
    folders: Folders,
}

impl Report {
    /// Writes the file.
    pub fn run(self) -> Result<(), Error> {
        let store = Store::open(&self.folders.store)?;
        let run = last_run(&store, self.name().as_deref())?;
        let Some(comparison) = Comparison::of(&run, &store)? else {
            let help =
                "a report compares the arms of a pipeline, as pipelines/ablation.ron has them";
            return Err(Error::usage("this run had no arms to compare", help));
        };
        let gallery = Gallery::of(&comparison, &store)?;
        let page = Page {
            comparison: &comparison,
            gallery: &gallery,
            run: &run,
            store: &store,
        };
        let html = page.html()?;
        std::fs::write(&self.output, &html).map_err(|error| {
            let message = format!("cannot write {}: {error}", self.output.display());
            Error::usage(message, "choose another place: -o FILE")
        })?;
        print(&format_args!(
            "wrote {} ({}); open it in a browser",
            self.output.display(),
            size(html.len() as u64)
        ));
        Ok(())
    }

    /// The pipeline's name: `pipelines/ablation.ron` is called as it says itself, or else as its
    /// file.
    fn name(&self) -> Option<String> {
        let word = self.pipeline.as_deref()?;
        let Some(stem) = word.strip_suffix(".ron") else {
            return Some(word.to_owned());
        };
        // Runs are recorded under the name that the pipeline gives itself, which may not be its
        // file's.
        let told = std::fs::read_to_string(word).ok().and_then(|text| {
            let tree = crate::pipeline::text::Tree::read(&text).ok()?;
            Some(tree.entry("name")?.tree.json().as_str()?.to_owned())
        });
        let file = stem.rsplit(['/', '\\']).next().unwrap_or(stem);
        Some(told.unwrap_or_else(|| file.to_owned()))
    }
}
