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
    pub fn files(&self, folder: &str) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut files = BTreeMap::new();
        collect(&self.path(folder), &mut files);
        files
            .into_iter()
            .map(|(path, bytes)| (path.strip_prefix(self.path(folder)).unwrap().into(), bytes))
            .collect()
    }
}

/// Two folders of a space hold the same files. Says which one differs first.
pub fn assert_same_files(space: &Space, one: &str, other: &str) {
    let ours = space.files(one);
    let theirs = space.files(other);
    let names: BTreeSet<_> = ours.keys().chain(theirs.keys()).collect();
    for name in names {
        let shown = name.display();
        match (ours.get(name), theirs.get(name)) {
            (Some(a), Some(b)) => {
                let differs = a.iter().zip(b).position(|(a, b)| a != b);
                let sizes = format!("{} and {} bytes", a.len(), b.len());
                assert!(
                    a == b,
                    "{shown} of {one} and {other}: {sizes}, byte {differs:?} differs"
                );
            }
            (Some(_), None) => panic!("{shown} is in {one} and not in {other}"),
            (None, _) => panic!("{shown} is in {other} and not in {one}"),
        }
    }
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

fn collect(folder: &Path, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(&path, files);
        } else {
            files.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
}
