//! `import`: poses for photos that have none, and a pipeline for them. Leaves the work to COLMAP.

use std::ffi::OsStr;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use super::error::Error;
use super::init::Init;
use crate::import::{self, ImportProgress, Imported, Places, Tool};
use crate::terminal::output::tell;

#[derive(Args)]
pub struct Import {
    /// A folder of photos, or a video
    photos: PathBuf,
    /// The folder to make, with links to the photos and their poses, by default PHOTOS_posed; the
    /// pipeline then has its name, and not that of the photos
    #[arg(short, long, value_name = "FOLDER")]
    output: Option<PathBuf>,
    /// Make the photos four times smaller first, and compare held-out views with them
    #[arg(long)]
    judge: bool,
    /// COLMAP's program, if it is not on the PATH
    #[arg(long, value_name = "PROGRAM", conflicts_with = "python")]
    colmap: Option<PathBuf>,
    /// A Python that has pycolmap
    #[arg(long, value_name = "PROGRAM")]
    python: Option<PathBuf>,
    /// COLMAP's name of the lens model
    #[arg(long, value_name = "MODEL", default_value = "OPENCV")]
    lens: String,
    /// Frames of a video that are taken, for each second
    #[arg(long, value_name = "NUMBER", default_value_t = 2.0)]
    rate: f64,
    /// The smallest part of the photos that must find a pose
    #[arg(long, value_name = "PART", default_value_t = 0.6)]
    least: f64,
}

impl Import {
    /// Finds poses, says how good they are, and writes the pipeline.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let name = self.name();
        let folder = self.output.clone();
        let folder = folder.unwrap_or(format!("{name}_posed").into());
        let named = match &self.output {
            Some(output) => plain(output.file_name()),
            None => name,
        };
        let pipeline = PathBuf::from(format!("{named}.ron"));
        // The pipeline is written last of all, and must not fail after hours because it is there.
        self.check(&[&folder, &pipeline])?;
        let tool = Tool::find(&Places {
            colmap: self.colmap.clone(),
            python: self.python.clone(),
        })?;
        let mut steps = Steps::new(json);
        steps.say(&format!("poses by {}", tool.name()));
        let import = import::Import {
            photos: self.photos,
            folder: folder.clone(),
            lens: self.lens,
            rate: self.rate,
            least: self.least,
        };
        let imported = import.run(&tool, &mut steps)?;
        steps.end();
        steps.say(&told(&imported, &folder));
        let init = Init {
            photos: Some(folder),
            output: Some(pipeline),
            judge: self.judge,
        };
        // From here on the folder is a scene like any other.
        init.run(json)
    }

    /// The photos' own name.
    fn name(&self) -> String {
        // `.` and `..` have no name of their own. The folders that they lead to have.
        let path = self.photos.canonicalize().unwrap_or(self.photos.clone());
        let name = match path.is_dir() {
            true => path.file_name(),
            false => path.file_stem(),
        };
        plain(name)
    }

    /// What can be known to be wrong before hours of work.
    fn check(&self, made: &[&Path]) -> Result<(), Error> {
        if !self.photos.exists() {
            let message = format!("there is no {}", self.photos.display());
            return Err(Error::usage(message, "give a folder of photos, or a video"));
        }
        for (value, name, most) in [(self.rate, "--rate", 1000.0), (self.least, "--least", 1.0)] {
            // Negated as a whole, so that NaN is refused too.
            if !(value > 0.0 && value <= most) {
                let message = format!("{name} is {value}");
                let help = format!("give a number above 0, and at most {most}");
                return Err(Error::usage(message, help));
            }
        }
        match made.iter().find(|path| path.exists()) {
            Some(path) => Err(Error::usage(
                format!("{} is there already", path.display()),
                "move it away, or choose another folder: --output FOLDER",
            )),
            None => Ok(()),
        }
    }
}

fn plain(name: Option<&OsStr>) -> String {
    name.unwrap_or_default().to_string_lossy().into_owned()
}

/// How good the poses are.
fn told(imported: &Imported, folder: &Path) -> String {
    let Imported { photos, registered } = imported;
    let error = registered.error.map_or(String::new(), |error| {
        format!(", mean reprojection error {error:.2} pixels")
    });
    format!(
        "{} of {photos} photos have a pose, {} points{error}\nwrote {}",
        registered.photos,
        registered.points,
        folder.display()
    )
}

/// Steps on standard error: bars on a terminal, else a line for each.
struct Steps {
    bar: ProgressBar,
    silent: bool,
}

impl Steps {
    fn new(silent: bool) -> Self {
        Self {
            bar: ProgressBar::hidden(),
            silent,
        }
    }

    fn say(&self, line: &str) {
        if !self.silent {
            tell(&line);
        }
    }

    fn end(&self) {
        self.bar.finish_and_clear();
    }
}

impl ImportProgress for Steps {
    fn begin(&mut self, what: &'static str) {
        // A bar that is not cleared would stay on the terminal above the next one.
        self.end();
        if self.silent {
            return;
        }
        if !std::io::stderr().is_terminal() {
            return tell(&what);
        }
        let style = ProgressStyle::with_template("{prefix:24} {wide_bar} {pos}/{len} {elapsed}");
        let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
        self.bar = ProgressBar::new(0).with_style(style).with_prefix(what);
    }

    fn at(&mut self, done: u64, all: u64) {
        self.bar.set_length(all);
        self.bar.set_position(done);
    }
}
