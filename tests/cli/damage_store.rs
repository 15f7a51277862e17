//! Every kind of damage that a store can take: `store fsck` finds it, names it and puts it out of
//! reach, and the next run comes to the same results again.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::space::{Files, Said, Space};

/// A store with the results of `tiny.ron`.
struct Victim {
    space: Space,
    /// What `inspect up` says: the key, the outputs, their blobs.
    up: Value,
    /// What people see.
    out: Files,
}

impl Victim {
    fn new() -> Self {
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
    fn blob(&self) -> PathBuf {
        self.fanned(
            "cas",
            self.up["outputs"]["images"]["files"][0]["blob"]
                .as_str()
                .unwrap(),
            "",
        )
    }

    fn result(&self) -> PathBuf {
        self.fanned("results", self.up["key"].as_str().unwrap(), ".json")
    }

    fn manifest(&self) -> PathBuf {
        self.fanned("manifests", self.up["key"].as_str().unwrap(), ".json")
    }

    fn fsck(&self, arguments: &[&str]) -> Said {
        self.space.say(&[&["store", "fsck"], arguments].concat())
    }

    /// Fsck names the damage: first it only looks, then it acts, then there is none any more. The
    /// next run heals what is lost.
    fn suffers(self, damage: &[&str], ran: &[&str]) {
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

    fn heals(self, ran: &[&str]) {
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
fn overwrite(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(path).unwrap();
    change(&mut bytes);
    fs::remove_file(path).unwrap();
    fs::write(path, bytes).unwrap();
    fs::set_permissions(path, Permissions::from_mode(0o444)).unwrap();
}

#[test]
fn a_sound_store_is_said_to_be_so() {
    let victim = Victim::new();
    let said = victim.fsck(&[]);
    assert_eq!(
        (said.code, said.out.lines().count()),
        (0, 1),
        "{}",
        said.out
    );
    assert!(said.out.starts_with("sound: 3 results, "), "{}", said.out);
}

#[test]
fn a_flipped_bit() {
    let victim = Victim::new();
    overwrite(&victim.blob(), |bytes| bytes[100] ^= 4);
    victim.suffers(
        &["its bytes have changed", "up: images/", "its blob is lost"],
        &["up"],
    );
}

#[test]
fn a_truncated_blob() {
    let victim = Victim::new();
    overwrite(&victim.blob(), |bytes| bytes.truncate(7));
    victim.suffers(&["cut short: 7 of ", "up: images/"], &["up"]);
}

#[test]
fn a_grown_blob() {
    let victim = Victim::new();
    overwrite(&victim.blob(), |bytes| bytes.extend(b"more"));
    victim.suffers(&["grown: ", "up: images/"], &["up"]);
}

#[test]
fn a_missing_blob() {
    let victim = Victim::new();
    fs::remove_file(victim.blob()).unwrap();
    victim.suffers(&["results/", "its blob is lost: up: images/"], &["up"]);
}

#[test]
fn a_blob_under_another_name_goes_back_to_its_place() {
    let victim = Victim::new();
    let lost = victim.blob().with_file_name("0".repeat(64));
    fs::rename(victim.blob(), lost).unwrap();
    victim.suffers(&["it is the blob "], &[]);
}

#[test]
fn a_blob_that_can_be_written_is_protected_again() {
    let victim = Victim::new();
    fs::set_permissions(victim.blob(), Permissions::from_mode(0o644)).unwrap();
    victim.suffers(&["it can be written"], &[]);
}

#[test]
fn a_folder_where_a_blob_should_be() {
    let victim = Victim::new();
    fs::remove_file(victim.blob()).unwrap();
    fs::create_dir_all(victim.blob().join("inner")).unwrap();
    victim.suffers(&["there is a folder", "its blob is lost"], &["up"]);
}

#[test]
fn a_link_that_leads_to_itself_where_a_blob_should_be() {
    let victim = Victim::new();
    fs::remove_file(victim.blob()).unwrap();
    symlink(victim.blob(), victim.blob()).unwrap();
    victim.suffers(&["there is a link", "its blob is lost"], &["up"]);
}

#[test]
fn a_file_where_a_folder_of_blobs_should_be() {
    let victim = Victim::new();
    let folders = (0..=255).map(|byte| victim.space.path(&format!(".srnerf/cas/{byte:02x}")));
    let free = folders.into_iter().find(|folder| !folder.exists()).unwrap();
    fs::write(free, "").unwrap();
    victim.suffers(&["cas/", "there is a file"], &[]);
}

#[test]
fn a_garbled_result() {
    let victim = Victim::new();
    overwrite(&victim.result(), |bytes| bytes.truncate(40));
    victim.suffers(&["results/", "garbled: "], &["up"]);
}

#[test]
fn a_result_of_another_version() {
    let victim = Victim::new();
    overwrite(&victim.result(), |bytes| {
        *bytes = json!({"format": 9, "data": []}).to_string().into()
    });
    victim.suffers(&["results/", "garbled: missing field `key`"], &["up"]);
}

#[test]
fn a_result_of_another_key() {
    let victim = Victim::new();
    let other = victim
        .result()
        .with_file_name(format!("{}.json", "0".repeat(64)));
    fs::rename(victim.result(), other).unwrap();
    victim.suffers(&["it is about the key "], &["up"]);
}

#[test]
fn a_result_that_leads_out_of_its_folder() {
    let victim = Victim::new();
    let mut result = victim.up.clone();
    result["outputs"]["images"]["files"][0]["path"] = "../../elsewhere".into();
    overwrite(&victim.result(), |bytes| *bytes = result.to_string().into());
    victim.suffers(&["leads out of its folder"], &["up"]);
}

#[test]
fn a_folder_where_a_result_should_be() {
    let victim = Victim::new();
    fs::remove_file(victim.result()).unwrap();
    fs::create_dir(victim.result()).unwrap();
    victim.suffers(&["results/", "there is a folder"], &["up"]);
}

#[test]
fn a_garbled_manifest() {
    let victim = Victim::new();
    overwrite(&victim.manifest(), |bytes| bytes[0] = b'?');
    let said = victim.fsck(&[]);
    assert!(
        said.code == 5 && said.out.contains("manifests/") && said.out.contains("garbled: "),
        "{}",
        said.out
    );
    victim.heals(&[]);
}

#[test]
fn a_manifest_that_disagrees_with_its_key() {
    let victim = Victim::new();
    let mut manifest: Value =
        serde_json::from_slice(&fs::read(victim.manifest()).unwrap()).unwrap();
    manifest["params.factor"] = "3.0".into();
    overwrite(&victim.manifest(), |bytes| {
        *bytes = manifest.to_string().into()
    });
    let said = victim.fsck(&[]);
    assert!(
        said.code == 5 && said.out.contains("it is about the key "),
        "{}",
        said.out
    );
    victim.heals(&[]);
}

#[test]
fn a_missing_manifest_is_written_again_by_a_run() {
    let victim = Victim::new();
    fs::remove_file(victim.manifest()).unwrap();
    let said = victim.fsck(&[]);
    assert!(
        said.code == 5 && said.out.contains("its manifest is gone"),
        "{}",
        said.out
    );
    victim.heals(&[]);
}

#[test]
fn a_garbled_record_of_a_run() {
    let victim = Victim::new();
    fs::write(
        victim
            .space
            .path(".srnerf/runs/20260101T000000.000Z-tiny.json"),
        "{",
    )
    .unwrap();
    victim.suffers(&["runs/", "garbled: "], &[]);
}

#[test]
fn what_people_see_is_not_what_the_store_has() {
    let shown = "out/tiny/up/images/view_001.exr";
    let acts: [fn(&Path); 3] = [
        |path| fs::write(path, "changed").unwrap(),
        |path| symlink("nowhere", path).unwrap(),
        |path| symlink(path, path).unwrap(),
    ];
    for act in acts {
        let victim = Victim::new();
        fs::remove_file(victim.space.path(shown)).unwrap();
        act(&victim.space.path(shown));
        let said = victim.fsck(&[]);
        assert!(
            said.code == 5 && said.out.contains(&format!("{shown}  it is not what")),
            "{}",
            said.out
        );
        victim.heals(&[]);
    }
}

#[test]
fn what_interrupted_runs_leave_is_named_and_is_no_damage() {
    let victim = Victim::new();
    let store = |name: &str| victim.space.path(".srnerf").join(name);
    fs::create_dir_all(store("work/c1d0/scratch")).unwrap();
    fs::write(store("tmp/.tmpAbCdEf"), "half").unwrap();
    let orphan = format!("cas/aa/{}", blake3::hash(b"orphan"));
    fs::create_dir_all(store("cas/aa")).unwrap();
    fs::write(store(&orphan), "orphan").unwrap();
    fs::set_permissions(store(&orphan), Permissions::from_mode(0o444)).unwrap();
    fs::write(store("notes.txt"), "mine").unwrap();
    let said = victim.fsck(&[]);
    assert_eq!(said.code, 0, "{}", said.out);
    for words in ["work/c1d0", "tmp/.tmpAbCdEf", "notes.txt", &orphan] {
        assert!(said.out.contains(words), "{words} is not in {}", said.out);
    }
    assert!(
        store("notes.txt").exists()
            && store("work/c1d0/scratch").exists()
            && store(&orphan).exists()
    );
}
