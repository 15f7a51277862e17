//! A folder of its own for each transcript, and the command run in it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// Three small stages in a row.
pub const TINY: &str = r#"(
    name: "tiny",
    stages: {
        "scene": Scene(source: Procedural(views: 3, size: (32, 24), samples: 1), downscale: 2, holdout: 2),
        "up": Interpolate(images: "scene.train", factor: 2),
        "again": Interpolate(images: "up", factor: 2),
    },
)"#;

/// Files by path, with their bytes.
pub type Files = BTreeMap<PathBuf, Vec<u8>>;

/// A folder with a pipeline, removed in the end.
pub struct Space {
    folder: tempfile::TempDir,
}

/// What a command said, and how it ended.
pub struct Said {
    pub code: i32,
    pub out: String,
    pub err: String,
}

impl Said {
    /// What a command said that has ended.
    pub fn new(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Self {
            code: output.status.code().unwrap_or(-1),
            out: text(output.stdout),
            err: text(output.stderr),
        }
    }

    /// The last line of JSON.
    pub fn last(&self) -> Value {
        serde_json::from_str(self.out.lines().last().unwrap()).unwrap()
    }

    /// All of standard output as JSON.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap()
    }
}

impl Space {
    /// A folder with `tiny.ron`.
    pub fn new() -> Self {
        let space = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        fs::write(space.path("tiny.ron"), TINY).unwrap();
        space
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_srnerf-dag"));
        command
            .args(arguments)
            .current_dir(self.folder.path())
            .env("NO_COLOR", "1");
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    pub fn say(&self, arguments: &[&str]) -> Said {
        Said::new(self.command(arguments).output().unwrap())
    }

    /// Runs a command with these variables in its environment.
    pub fn say_with(&self, variables: &[(&str, String)], arguments: &[&str]) -> Said {
        Said::new(
            self.command(arguments)
                .envs(variables.iter().cloned())
                .output()
                .unwrap(),
        )
    }

    /// Runs a command that must end well.
    pub fn ok(&self, arguments: &[&str]) -> Said {
        let said = self.say(arguments);
        assert_eq!(said.code, 0, "{arguments:?}: {}", said.err);
        said
    }

    pub fn spawn(&self, arguments: &[&str]) -> Child {
        self.command(arguments).spawn().unwrap()
    }

    pub fn wait(child: Child) -> Said {
        Said::new(child.wait_with_output().unwrap())
    }

    /// Who may read and write a file.
    pub fn mode(&self, name: &str) -> u32 {
        fs::metadata(self.path(name)).unwrap().permissions().mode()
    }

    /// All files under a folder with their bytes.
    pub fn files(&self, folder: &str) -> Files {
        let mut files = BTreeMap::new();
        collect(&self.path(folder), &mut files);
        files
            .into_iter()
            .map(|(path, bytes)| (path.strip_prefix(self.path(folder)).unwrap().into(), bytes))
            .collect()
    }

    /// A folder holds these files. Says which one differs first.
    #[track_caller]
    pub fn assert_files(&self, folder: &str, expected: &Files) {
        assert_eq!(difference(&self.files(folder), expected), None, "{folder}");
    }
}

/// Two folders of a space hold the same files. Says which one differs first.
#[track_caller]
pub fn assert_same_files(space: &Space, one: &str, other: &str) {
    space.assert_files(other, &space.files(one));
}

/// What first tells files from those that are expected.
fn difference(files: &Files, expected: &Files) -> Option<String> {
    let names: BTreeSet<_> = files.keys().chain(expected.keys()).collect();
    let told = |name: &PathBuf| match (files.get(name), expected.get(name)) {
        (Some(a), Some(b)) if a == b => None,
        (Some(a), Some(b)) => {
            let byte = a.iter().zip(b).position(|(a, b)| a != b);
            let sizes = format!("{} bytes, not {}", a.len(), b.len());
            Some(format!(
                "{}: {sizes}, byte {byte:?} differs",
                name.display()
            ))
        }
        (None, _) => Some(format!("{} is missing", name.display())),
        (_, None) => Some(format!("{} is not expected", name.display())),
    };
    names.into_iter().find_map(told)
}

/// Waits until something has come about, however long the machine takes.
pub fn wait_until(what: &str, mut there: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !there() {
        assert!(
            begun.elapsed() < Duration::from_secs(120),
            "{what}: not in two minutes"
        );
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Sends a signal to a process.
pub fn signal(child: &Child, name: &str) {
    assert!(
        Command::new("kill")
            .args([name, &child.id().to_string()])
            .status()
            .unwrap()
            .success()
    );
}

fn collect(folder: &Path, files: &mut Files) {
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(&path, files);
        } else {
            files.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
}
