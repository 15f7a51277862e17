//! `export transforms`: image sets as a scene that other programs train on. Writes one folder.

use std::path::{Path, PathBuf};

use artifacts_schema::{Artifact, ImageSet};
use clap::Args;
use serde_json::json;
use stages::dataset;

use super::output::{print, print_json};
use crate::error::Error;

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
        if self.output.exists() {
            return Err(Error::usage(
                format!("{} is there already", self.output.display()),
                "choose another place",
            ));
        }
        let train = read(&self.train)?;
        let test = self.test.as_deref().map(read).transpose()?;
        self.write(&train, test.as_ref())?;
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

    /// All or nothing: beside its place first, then in it.
    fn write(&self, train: &ImageSet, test: Option<&ImageSet>) -> Result<(), Error> {
        let parent = self
            .output
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let refuse = |error: &dyn std::fmt::Display| {
            Error::usage(
                format!("cannot write {}: {error}", self.output.display()),
                "choose another place",
            )
        };
        let work = tempfile::tempdir_in(parent).map_err(|error| refuse(&error))?;
        let scene = work.path().join("scene");
        dataset::write(&scene, train, test).map_err(|error| refuse(&error))?;
        std::fs::rename(&scene, &self.output).map_err(|error| refuse(&error))
    }
}

fn read(folder: &Path) -> Result<ImageSet, Error> {
    ImageSet::read(folder).map_err(|error| {
        Error::usage(
            error.to_string(),
            "give the folder of an image set, with transforms.json and EXR files",
        )
    })
}
