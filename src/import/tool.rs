//! The program that finds poses: COLMAP, or the same as a library of Python. Knows its commands and
//! what it prints, of all versions from 3.6.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::ImportError;
use super::step::{self, ImportProgress, Step};

/// The steps as a library of Python has them.
const PYCOLMAP: &str = include_str!("pycolmap.py");
/// So many photos are compared with so many at a time: progress is told after each block.
const BLOCK: &str = "10";

/// Where to look.
#[derive(Default)]
pub struct Places {
    /// COLMAP's program.
    pub colmap: Option<PathBuf>,
    /// A Python that has `pycolmap`.
    pub python: Option<PathBuf>,
}

/// A program that finds poses.
#[derive(Clone, Debug, PartialEq)]
pub struct Tool {
    program: PathBuf,
    is_python: bool,
    version: (u32, u32),
    cuda: bool,
}

impl Tool {
    /// The one that was named, or the newest of those that are here.
    pub fn find(places: &Places) -> Result<Self, ImportError> {
        match (&places.python, &places.colmap) {
            (Some(python), _) => Self::pycolmap(python),
            (None, Some(colmap)) => Self::colmap(colmap),
            (None, None) => {
                let colmap = Self::colmap(Path::new("colmap")).ok();
                let python = Self::pycolmap(Path::new("python3")).ok();
                let found = colmap.into_iter().chain(python);
                // Of two that are equally new the last: it needs no window system.
                let newest = found.max_by_key(|tool| tool.version);
                newest.ok_or(ImportError::NoTool)
            }
        }
    }

    fn colmap(program: &Path) -> Result<Self, ImportError> {
        let said = ask(program, &["help"], "COLMAP")?;
        let version = said.split_once("COLMAP ").map(|(_, rest)| rest);
        Self::new(program, false, version, "COLMAP", &said)
    }

    fn pycolmap(program: &Path) -> Result<Self, ImportError> {
        let script = "import pycolmap as p; print(p.__version__, 'with' if p.has_cuda else 'without', 'CUDA')";
        let said = ask(program, &["-c", script], "Python with pycolmap")?;
        Self::new(program, true, Some(&said), "Python with pycolmap", &said)
    }

    fn new(
        program: &Path,
        is_python: bool,
        version: Option<&str>,
        what: &'static str,
        said: &str,
    ) -> Result<Self, ImportError> {
        let version = version.and_then(version_of);
        let version = version.ok_or_else(|| ImportError::NotATool {
            path: program.to_owned(),
            what,
            fault: format!("its version cannot be read in {:?}", first_line(said)),
        })?;
        Ok(Self {
            program: program.to_owned(),
            is_python,
            version,
            cuda: !said.contains("without CUDA"),
        })
    }

    /// What it is, for people.
    pub fn name(&self) -> String {
        let (major, minor) = self.version;
        match self.is_python {
            true => format!("pycolmap {major}.{minor}"),
            false => format!("COLMAP {major}.{minor}"),
        }
    }

    /// Which mappers there are, in the order in which they are tried: global or not.
    pub fn mappers(&self) -> &'static [bool] {
        match self.version.0 {
            // COLMAP has a global mapper from version 4 on.
            ..4 => &[false],
            4.. => &[true, false],
        }
    }

    /// Does a step with `photos` photos in a folder.
    pub fn run(
        &self,
        step: &Step,
        work: &Path,
        photos: usize,
        progress: &mut dyn ImportProgress,
    ) -> Result<(), ImportError> {
        let mut command = match self.is_python {
            true => self.python_command(step, work),
            false => self.colmap_command(step, work),
        };
        step::run(step.what(), &mut command, work, progress, |line| {
            how_far(line, photos as u64)
        })
    }

    fn python_command(&self, step: &Step, work: &Path) -> Command {
        let mut command = Command::new(&self.program);
        command.args(["-c", PYCOLMAP]).arg(work);
        match step {
            Step::Features { lens, one_lens } => {
                command.args(["features", lens, if *one_lens { "SINGLE" } else { "AUTO" }])
            }
            Step::Matches { in_time: false } => command.args(["matches", BLOCK]),
            Step::Matches { in_time: true } => command.arg("matches_in_time"),
            Step::Poses { global: true } => command.arg("global_poses"),
            Step::Poses { global: false } => command.arg("poses"),
        };
        command
    }

    fn colmap_command(&self, step: &Step, work: &Path) -> Command {
        let name = match step {
            Step::Features { .. } => "feature_extractor",
            Step::Matches { in_time: false } => "exhaustive_matcher",
            Step::Matches { in_time: true } => "sequential_matcher",
            Step::Poses { global: true } => "global_mapper",
            Step::Poses { global: false } => "mapper",
        };
        // Options have changed their names between versions, and COLMAP refuses those that it does
        // not know.
        let known = ask(&self.program, &[name, "--help"], "COLMAP").unwrap_or_default();
        let mut command = Command::new(&self.program);
        command.arg(name);
        command.arg("--database_path").arg(work.join("database.db"));
        if !matches!(step, Step::Matches { .. }) {
            command.arg("--image_path").arg(work.join("images"));
        }
        match step {
            Step::Features { lens, one_lens } => {
                command.args(["--ImageReader.camera_model", lens]);
                command.args([
                    "--ImageReader.single_camera",
                    if *one_lens { "1" } else { "0" },
                ]);
            }
            Step::Matches { .. } if known.contains("ExhaustiveMatching.block_size") => {
                command.args(["--ExhaustiveMatching.block_size", BLOCK]);
            }
            Step::Matches { .. } => {}
            Step::Poses { .. } => {
                command.arg("--output_path").arg(work.join("sparse"));
            }
        }
        // Without CUDA the same work is done by OpenGL, which needs a window system.
        let gpu = known
            .split_whitespace()
            .find(|word| word.ends_with(".use_gpu"));
        if let (Some(gpu), false) = (gpu, self.cuda) {
            command.args([gpu, "0"]);
        }
        command
    }
}

/// What a program answers, on both outputs.
fn ask(program: &Path, arguments: &[&str], what: &'static str) -> Result<String, ImportError> {
    let refuse = |fault: String| ImportError::NotATool {
        path: program.to_owned(),
        what,
        fault,
    };
    let mut command = Command::new(program);
    let asked = command.args(arguments).stdin(Stdio::null()).output();
    let answer = asked.map_err(|error| refuse(error.to_string()))?;
    let said = [answer.stdout, answer.stderr].concat();
    let said = String::from_utf8_lossy(&said).into_owned();
    match answer.status.success() || said.contains("COLMAP") {
        true => Ok(said),
        false => Err(refuse(
            said.trim().lines().last().unwrap_or("nothing").to_owned(),
        )),
    }
}

fn first_line(text: &str) -> &str {
    text.trim().lines().next().unwrap_or_default()
}

/// The version that a text begins with: `4.2.1 …` or `3.12-dev …`.
fn version_of(text: &str) -> Option<(u32, u32)> {
    let word = text.split_whitespace().next()?;
    let mut numbers = word.split(|c: char| !c.is_ascii_digit());
    let major = numbers.next()?.parse().ok()?;
    let minor = numbers.next().and_then(|number| number.parse().ok());
    Some((major, minor.unwrap_or(0)))
}

/// How far a step is by a line that it printed: `Processed file [3/20]`, `Matching block [1/2,
/// 1/2]`, `Registering image #7 (4)`, `… (num_reg_frames=4)`.
fn how_far(line: &str, photos: u64) -> Option<(u64, u64)> {
    let number = |text: &str| text.trim().parse::<u64>().ok();
    let fraction = |text: &str| {
        let (done, all) = text.split_once('/')?;
        Some((number(done)?, number(all)?))
    };
    if let Some((_, rest)) = line.split_once("Registering image") {
        let count = rest.rsplit_once('(')?.1.split(')').next()?;
        return Some((number(count.rsplit('=').next()?)?, photos));
    }
    let inside = line.split_once('[')?.1.split_once(']')?.0;
    if line.contains("Processed file") {
        return fraction(inside);
    }
    let (first, second) = inside.split_once(',')?;
    let (row, rows) = fraction(first)?;
    let (column, columns) = fraction(second)?;
    // Blocks go row by row, both numbers from 1.
    let done = row.checked_sub(1)? * columns + column;
    line.contains(" block [").then_some((done, rows * columns))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_read_as_programs_tell_them() {
        assert_eq!(version_of("3.8 -- Structure-from-Motion"), Some((3, 8)));
        assert_eq!(version_of("4.2.1 without CUDA"), Some((4, 2)));
        assert_eq!(version_of("3.12-dev (Commit"), Some((3, 12)));
        assert_eq!(version_of("what"), None);
    }

    #[test]
    fn lines_of_all_versions_tell_how_far_a_step_is() {
        let at = |line| how_far(line, 20);
        assert_eq!(at("Processed file [3/20]"), Some((3, 20)));
        let logged =
            "I20261129 15:43:32.795927 1400 feature_extraction.cc:270] Processed file [1/20]";
        assert_eq!(
            how_far(&logged[logged.find("Pro").unwrap_or(0)..], 20),
            Some((1, 20))
        );
        assert_eq!(at(logged), Some((1, 20)));
        assert_eq!(at("Matching block [2/3, 1/3] in 4.2s"), Some((4, 9)));
        assert_eq!(at("Registering image #15 (3)"), Some((3, 20)));
        assert_eq!(
            at("Registering image #15 (num_reg_frames=3)"),
            Some((3, 20))
        );
        assert_eq!(at("  Name:            image[0].png"), None);
    }
}
