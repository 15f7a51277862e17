//! A store for tests to damage, and what must hold of it then: `store fsck` names the damage and
//! puts it out of reach, and the next run comes to the same results again.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::files::Files;
use crate::space::{Said, Space};

/// A store with the results of `tiny.ron`.
pub struct Victim {
    pub space: Space,
    /// What `inspect up` says: the key, the outputs, their blobs.
    pub up: Value,
    /// What people see.
    out: Files,
}

impl Victim {
    pub fn new() -> Self {
        let space = Space::new();
        space.ok(&["run", "tiny.ron"]);
        let up = space.ok(&["inspect", "up", "tiny.ron", "--json"]).json();
        let out = space.files("out");
        Self { space, up, out }
    }

    fn fanned(&self, folder: &str, name: &str, extension: &str) -> PathBuf {
        self.space.path(&format!(
            ".srnerf/{folder}/{}/{name}{extension}",
            &name[..2]
        ))
    }

    /// The blob of `up`'s first image.
    pub fn blob(&self) -> PathBuf {
        self.fanned(
            "cas",
            self.up["outputs"]["images"]["files"][0]["blob"]
                .as_str()
                .unwrap(),
            "",
        )
    }

    pub fn result(&self) -> PathBuf {
        self.fanned("results", self.up["key"].as_str().unwrap(), ".json")
    }

    pub fn manifest(&self) -> PathBuf {
        self.fanned("manifests", self.up["key"].as_str().unwrap(), ".json")
    }

    pub fn fsck(&self, arguments: &[&str]) -> Said {
        self.space.say(&[&["store", "fsck"], arguments].concat())
    }

    /// Fsck names the damage: first it only looks, then it acts, then there is none any more. The
    /// next run heals what is lost.
    pub fn suffers(self, damage: &[&str], ran: &[&str]) {
        for arguments in [&["--dry-run"][..], &[]] {
            let said = self.fsck(arguments);
            assert_eq!(said.code, 5, "{damage:?}: {}{}", said.out, said.err);
            damage.iter().for_each(|words| {
                assert!(said.out.contains(words), "{words} is not in {}", said.out)
            });
        }
        let again = self.fsck(&[]);
        assert!(
            again.code == 0 && !again.out.contains("damaged"),
            "{damage:?}: {}",
            again.out
        );
        self.heals(ran);
    }

    pub fn heals(self, ran: &[&str]) {
        assert_eq!(
            self.space.ok(&["run", "tiny.ron", "--json"]).last()["ran"],
            json!(ran)
        );
        assert_eq!(
            self.space
                .ok(&["inspect", "up", "tiny.ron", "--json"])
                .json()["outputs"],
            self.up["outputs"]
        );
        self.space.assert_files("out", &self.out);
        assert_eq!(self.fsck(&[]).code, 0);
    }
}

/// Writes in place, as only damage can.
pub fn overwrite(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(path).unwrap();
    change(&mut bytes);
    fs::remove_file(path).unwrap();
    fs::write(path, bytes).unwrap();
    fs::set_permissions(path, Permissions::from_mode(0o444)).unwrap();
}
