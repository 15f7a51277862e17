//! `export nerfstudio|brush|colmap|instant-ngp`: image sets as a scene that these programs train
//! on. Writes one folder.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use scene::{Layout, LayoutError};
use serde_json::json;
use stages::dataset::{self, Exported};
use stages::surface::{self, Surface};

use super::error::Error;
use super::{artifact, whole};
use crate::terminal::output::{print, print_json, tell};

/// Options of these exports.
#[derive(Args)]
pub struct Views {
    /// The images to train on: the folder of an image set (out/i3ds/i3ds.4.decode/images)
    train: PathBuf,
    /// The test images, another such folder
    test: Option<PathBuf>,
    /// The folder to write, which must not be there yet
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
    /// What to write pictures as: 8-bit sRGB, or the scene-linear EXR files themselves (only
    /// instant-ngp reads them)
    #[arg(long, value_enum, default_value_t = Images::Png)]
    images: Images,
    /// A field whose surface gives the points that splats begin with: field.safetensors, or its
    /// folder
    #[arg(long, value_name = "FIELD")]
    points: Option<PathBuf>,
}

/// What pictures are written as.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Images {
    Png,
    Exr,
}

impl Views {
    /// Writes the folder and says what is in it.
    pub fn run(self, layout: Layout, json: bool) -> Result<(), Error> {
        let train = artifact::images(&self.train)?;
        let test = self.test.as_deref().map(artifact::images).transpose()?;
        let surface = self.surface()?;
        let is_exr = self.images == Images::Exr;
        let train_source = Exported {
            images: &train,
            exr: is_exr.then_some(&self.train),
        };
        let test_source = test.as_ref().map(|images| Exported {
            images,
            exr: self.test.as_deref().filter(|_| is_exr),
        });
        let notes = whole::folder(&self.output, |folder| {
            dataset::export(folder, layout, train_source, test_source, &surface)
                .map_err(|error| self.refused(&error))
        })?;
        let trains = train.views.len();
        let tests = test.as_ref().map_or(0, |test| test.views.len());
        let points = surface.vertices.len();
        if json {
            let counts =
                json!({"train": trains, "test": tests, "points": points, "warnings": notes});
            print_json(&counts);
            return Ok(());
        }
        notes
            .iter()
            .for_each(|note| tell(&format_args!("warning: {note}")));
        print(&format_args!(
            "{}: {trains} training images, {tests} test images, {points} points for {}",
            self.output.display(),
            layout.name()
        ));
        Ok(())
    }

    fn surface(&self) -> Result<Surface, Error> {
        let Some(path) = &self.points else {
            return Ok(Surface::default());
        };
        let field = artifact::field(path)?;
        let level = surface::usual_level(&field);
        Ok(surface::surface(&field, surface::USUAL_RESOLUTION, level))
    }

    fn refused(&self, error: &LayoutError) -> Error {
        match error {
            LayoutError::Unheld { remedy, .. } => Error::usage(error.to_string(), *remedy),
            _ => whole::refused(&self.output, error),
        }
    }
}
