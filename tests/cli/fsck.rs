//! `store fsck` of a store that is sound: as it is, beside changed files that people see, and with
//! what interrupted runs leave.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;

use crate::victim::Victim;

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
