//! A store where it is not at home: one that can only be read, and one on another file system.

use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::json;

use crate::files::assert_same_files;
use crate::space::{Said, Space};

/// A run as a user who may read everything and write only to `out`.
fn as_reader(space: &Space, arguments: &[&str]) -> Said {
    let command = space.command(arguments);
    let program = space.path("srnerf-dag");
    // Root may write anything, and its programs may lie where nobody else can go.
    if fs::metadata(space.path(".")).unwrap().uid() != 0 {
        return Space::wait({ command }.spawn().unwrap());
    }
    fs::copy(command.get_program(), &program).unwrap();
    let mut copy = Command::new(program);
    copy.args(arguments)
        .current_dir(space.path("."))
        .uid(65534)
        .gid(65534);
    Space::wait(
        copy.stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap(),
    )
}

#[test]
fn a_store_that_can_only_be_read_serves_all_that_is_in_it() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let chmod = |folder: &str, mode: u32| {
        let all = walkdir::WalkDir::new(space.path(folder))
            .contents_first(true)
            .into_iter()
            .flatten();
        all.filter(|entry| entry.file_type().is_dir())
            .for_each(|entry| {
                fs::set_permissions(entry.path(), fs::Permissions::from_mode(mode)).unwrap()
            });
    };
    chmod(".srnerf", 0o555);
    fs::set_permissions(
        space.path(".srnerf/lock"),
        fs::Permissions::from_mode(0o444),
    )
    .unwrap();
    fs::set_permissions(space.path("."), fs::Permissions::from_mode(0o755)).unwrap();
    for arguments in [
        &["plan", "tiny.ron", "--exit-code"][..],
        &["explain", "up", "tiny.ron"],
        &["inspect", "up", "tiny.ron"],
        &["store", "fsck", "--dry-run"],
        &["gc"],
        &["run", "tiny.ron"],
    ] {
        let said = as_reader(&space, arguments);
        assert_eq!(said.code, 0, "{arguments:?}: {}", said.err);
    }
    let refused = as_reader(&space, &["run", "tiny.ron", "--set", "up.filter=Lanczos"]);
    assert_eq!(refused.code, 4, "{}", refused.err);
    assert!(
        refused.err.contains("cannot") && refused.err.contains("--store FOLDER"),
        "{}",
        refused.err
    );
    chmod(".srnerf", 0o755);
}

/// A folder on another file system than the temporary folders, if this machine has one that anybody
/// may write to.
fn far_away(space: &Space) -> Option<tempfile::TempDir> {
    let far = tempfile::tempdir_in("/dev/shm").ok()?;
    let device = |path: &Path| fs::metadata(path).unwrap().dev();
    (device(far.path()) != device(&space.path("."))).then_some(far)
}

#[test]
fn a_store_on_another_file_system_is_shown_by_copies() {
    let space = Space::new();
    let Some(far) = far_away(&space) else {
        eprintln!("not tested: there is no second file system here");
        return;
    };
    let store = format!("--store={}", far.path().join("store").display());
    let run = |more: &[&str]| {
        space
            .ok(&[&["run", "tiny.ron", "--json"], more].concat())
            .last()["ran"]
            .clone()
    };
    assert_eq!(run(&[&store]), json!(["again", "scene", "up"]));
    assert_eq!(
        run(&["--store=near/store", "--out=near/out"]),
        json!(["again", "scene", "up"])
    );
    assert_same_files(&space, "out", "near/out");
    let shown = space.path("out/tiny/up/images/view_001.exr");
    assert_eq!(
        fs::metadata(&shown).unwrap().nlink(),
        1,
        "a copy, not a second name"
    );
    fs::remove_file(&shown).unwrap();
    fs::write(&shown, "changed").unwrap();
    let fsck = space.say(&["store", "fsck", &store]);
    assert!(
        fsck.code == 5 && fsck.out.contains("view_001.exr  it is not what"),
        "{}",
        fsck.out
    );
    assert_eq!(run(&[&store]), json!([]));
    assert_same_files(&space, "out", "near/out");
    space.ok(&["store", "fsck", &store]);
}
