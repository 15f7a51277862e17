//! One step of another program: started, watched by the lines that it prints, and kept in a log.
//! Knows no program.

use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::ImportError;

/// How many of its last lines a failure repeats.
const LAST_LINES: usize = 3;

/// A step on the way from photos to poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step<'a> {
    /// Points that can be found again, in each photo.
    Features {
        /// COLMAP's name of the lens model.
        lens: &'a str,
        /// All photos are of one lens.
        one_lens: bool,
    },
    /// The same points in several photos.
    Matches {
        /// Only photos that follow one another are compared.
        in_time: bool,
    },
    /// Where photos were taken.
    Poses {
        /// All at once, not one after another.
        global: bool,
    },
}

impl Step<'_> {
    /// What it does.
    pub fn what(&self) -> &'static str {
        match self {
            Self::Features { .. } => "finding points in photos",
            Self::Matches { .. } => "comparing photos",
            Self::Poses { .. } => "finding poses",
        }
    }
}

/// What is told how far a step is.
pub trait ImportProgress {
    /// A step begins, of which nothing else is known.
    fn begin(&mut self, what: &'static str);
    /// So many parts of so many are done.
    fn at(&mut self, done: u64, all: u64);
}

/// Where what programs said is kept.
pub fn log(work: &Path) -> PathBuf {
    work.join("import.log")
}

/// Runs a program to its end. What it prints goes to the log; of each line `at` says how far it is.
pub fn run(
    what: &'static str,
    command: &mut Command,
    work: &Path,
    progress: &mut dyn ImportProgress,
    at: impl Fn(&str) -> Option<(u64, u64)>,
) -> Result<(), ImportError> {
    let log = log(work);
    let refuse = |error| ImportError::file(&log, error);
    progress.begin(what);
    // All steps share one log, which a failure leaves for people to read.
    let file = OpenOptions::new().create(true).append(true).open(&log);
    let mut file = file.map_err(refuse)?;
    writeln!(file, "{command:?}").map_err(refuse)?;
    // Both outputs in one pipe, so that lines stay in their order.
    let (reader, writer) = std::io::pipe().map_err(refuse)?;
    let other = writer.try_clone().map_err(refuse)?;
    // With nothing to read, so that a program that asks something does not wait for ever.
    command.stdin(Stdio::null()).stdout(writer).stderr(other);
    let started = command.spawn();
    // The command holds the pipe's other end; with it open there would be no end of lines.
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = started.map_err(|error| ImportError::Failed {
        what,
        status: "not started".into(),
        last: error.to_string(),
        log: log.clone(),
    })?;
    let last = watch(reader, &mut file, |line| {
        if let Some((done, all)) = at(line) {
            progress.at(done, all);
        }
    });
    let last = last.map_err(refuse)?;
    let status = child.wait().map_err(refuse)?;
    match status.success() {
        true => Ok(()),
        false => Err(ImportError::Failed {
            what,
            status: status.to_string(),
            last,
            log: log.clone(),
        }),
    }
}

/// Copies lines to the log as they come, and returns the last ones.
fn watch(
    reader: impl std::io::Read,
    log: &mut File,
    mut each: impl FnMut(&str),
) -> std::io::Result<String> {
    let mut last = VecDeque::new();
    let mut reader = BufReader::new(reader);
    let mut bytes = Vec::new();
    while reader.read_until(b'\n', &mut bytes)? > 0 {
        log.write_all(&bytes)?;
        // Names of photos need not be UTF-8.
        let line = String::from_utf8_lossy(&bytes).trim().to_owned();
        bytes.clear();
        each(&line);
        if !line.is_empty() {
            last.push_back(line);
        }
        if last.len() > LAST_LINES {
            last.pop_front();
        }
    }
    let last: Vec<String> = last.into();
    Ok(last.join("; "))
}
