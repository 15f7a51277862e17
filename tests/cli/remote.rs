//! A store that machines share in a folder.

use std::fs;
use std::path::PathBuf;

use serde_json::{Value, json};

use crate::files::assert_same_files;
use crate::space::{Said, Space};

/// A run on a machine of its own, that is, with a store and an output folder of its own.
fn run(space: &Space, machine: &str, remote: &str) -> Said {
    let store = format!("--store={machine}/store");
    let out = format!("--out={machine}/out");
    space.ok(&[
        "run", "tiny.ron", "--json", &store, &out, "--remote", remote,
    ])
}

pub fn events(said: &Said, name: &str) -> Vec<Value> {
    let all = said
        .out
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap());
    all.filter(|event| event["event"] == name).collect()
}

/// The largest blob of a shared folder: that of an image.
fn largest_blob(space: &Space) -> PathBuf {
    let blobs = space.files("shared/cas");
    let (path, _) = blobs.iter().max_by_key(|(_, bytes)| bytes.len()).unwrap();
    space.path("shared/cas").join(path)
}

fn flip_a_bit(path: &PathBuf) {
    let mut bytes = fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(path, bytes).unwrap();
}

#[test]
fn what_one_machine_computed_another_fetches() {
    let space = Space::new();
    assert_eq!(
        run(&space, "a", "shared").last()["ran"],
        json!(["again", "scene", "up"])
    );
    let plan = space
        .ok(&["plan", "tiny.ron", "--store=b/store", "--remote", "shared"])
        .out;
    assert!(plan.contains("again  cached  in the remote\n"), "{plan}");
    let second = run(&space, "b", "shared");
    assert_eq!(
        (&second.last()["ran"], events(&second, "fetched").len()),
        (&json!([]), 3)
    );
    assert_same_files(&space, "a/out", "b/out");
    let explained = space
        .ok(&["explain", "up", "tiny.ron", "--store=b/store"])
        .out;
    assert!(
        explained.contains("up: its result is in the store"),
        "{explained}"
    );
    assert_eq!(events(&run(&space, "b", "shared"), "fetched").len(), 0);
}

#[test]
fn a_plan_makes_no_folder_and_a_remote_that_is_a_file_is_refused() {
    let space = Space::new();
    let plan = space
        .ok(&["plan", "tiny.ron", "--remote", "shared/team store"])
        .out;
    assert!(
        plan.contains("3 to run") && !space.path("shared").exists(),
        "{plan}"
    );
    run(&space, "a", "shared/team store");
    assert!(space.path("shared/team store/results").is_dir());
    let said = space.say(&["plan", "tiny.ron", "--remote", "tiny.ron"]);
    assert!(
        said.code == 2 && said.err.contains("it is no folder"),
        "{}",
        said.err
    );
}

#[test]
fn a_damaged_result_of_the_remote_is_no_hit_and_is_replaced() {
    let damages: [fn(&PathBuf); 3] = [
        flip_a_bit,
        |path| fs::remove_file(path).unwrap(),
        |path| fs::write(path, "").unwrap(),
    ];
    for damage in damages {
        let space = Space::new();
        run(&space, "a", "shared");
        let url = format!("file://{}", space.path("shared").display());
        let blob = largest_blob(&space);
        fs::set_permissions(&blob, std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
        damage(&blob);
        let second = run(&space, "b", &url);
        assert_eq!(second.last()["ran"], json!(["again"]));
        let notices = events(&second, "notice");
        assert!(
            notices.len() == 1
                && notices[0]["text"]
                    .to_string()
                    .contains("has a damaged result"),
            "{notices:?}"
        );
        assert_same_files(&space, "a/out", "b/out");
        let third = run(&space, "c", &url);
        assert_eq!(
            (
                events(&third, "fetched").len(),
                events(&third, "notice").len()
            ),
            (3, 0)
        );
    }
}

#[test]
fn damage_at_home_is_healed_from_the_remote() {
    let space = Space::new();
    run(&space, "a", "shared");
    for (path, _) in space.files("a/store/cas") {
        fs::remove_file(space.path("a/store/cas").join(path)).unwrap();
    }
    let again = run(&space, "a", "shared");
    assert_eq!(
        (&again.last()["ran"], events(&again, "fetched").len()),
        (&json!([]), 3)
    );
}

#[test]
fn results_are_pushed_and_pulled_without_a_pipeline() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron", "--store=a/store"]);
    let pushed = space
        .ok(&["store", "push", "shared", "--store=a/store"])
        .out;
    assert!(pushed.starts_with("pushed 3 results, "), "{pushed}");
    assert_eq!(
        space
            .ok(&["store", "push", "shared", "--store=a/store"])
            .out,
        "pushed 0 results, 0 B\n"
    );
    flip_a_bit(&largest_blob(&space));
    let pulled = space.ok(&["store", "pull", "shared", "--store=b/store"]);
    assert!(
        pulled.out.starts_with("pulled 2 results, "),
        "{}",
        pulled.out
    );
    assert!(
        pulled
            .err
            .contains("is left out: blob damaged: images/view_"),
        "{}",
        pulled.err
    );
    assert_eq!(
        space
            .ok(&["run", "tiny.ron", "--json", "--store=b/store"])
            .last()["ran"],
        json!(["again"])
    );
}

#[test]
fn an_address_that_leads_nowhere_is_said_before_anything_runs() {
    let space = Space::new();
    let said = space.say(&["run", "tiny.ron", "--remote", "ftp://host/folder"]);
    assert_eq!(said.code, 2);
    assert!(
        said.err.contains("there is no `ftp` here") && said.err.contains("s3://BUCKET/FOLDER"),
        "{}",
        said.err
    );
    assert!(!space.path(".srnerf").exists());
}
