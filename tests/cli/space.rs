//! A folder of its own for each transcript, and the command run in it.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
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

/// A folder with a pipeline, removed in the end unless the test fails.
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
}

impl Drop for Space {
    /// Whoever looks into a failed test finds its folder.
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.folder.disable_cleanup(true);
            println!("the folder is kept: {}", self.folder.path().display());
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
