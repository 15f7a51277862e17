//! `export transforms`: image sets as a NeRF-synthetic scene. Writes one folder.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;
use stages::dataset;

use super::error::Error;
use super::{artifact, whole};
use crate::terminal::output::{print, print_json};

/// Options of `export transforms`.
#[derive(Args)]
pub struct Transforms {
    /// The training images: the folder of an image set (out/i3ds/main/scene/train)
    train: PathBuf,
    /// The test images, another such folder
    test: Option<PathBuf>,
    /// The folder to write, which must not be there yet
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
}

impl Transforms {
    /// Writes the folder and says what is in it.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let train = artifact::images(&self.train)?;
        let test = self.test.as_deref().map(artifact::images).transpose()?;
        whole::folder(&self.output, |folder| {
            dataset::write(folder, &train, test.as_ref())
                .map_err(|error| whole::refused(&self.output, &error))
        })?;
        let trains = train.views.len();
        let tests = test.map_or(0, |test| test.views.len());
        match json {
            true => print_json(&json!({"train": trains, "test": tests})),
            false => print(&format_args!(
                "{}: {trains} training images, {tests} test images",
                self.output.display()
            )),
        }
        Ok(())
    }
}
