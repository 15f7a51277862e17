//! A training cut off in the middle goes on where it was, and ends with the bits of one that was
//! left alone.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::files::assert_same_files;
use crate::space::{Said, Space, signal, wait_until};

/// A training of about a second, then one that goes on from it.
pub const TRAINING: &str = r#"(
    name: "training",
    stages: {
        "scene": Scene(source: Procedural(views: 4, size: (48, 36), samples: 1), downscale: 2, holdout: 4),
        "fit": Fit(images: "scene.train", steps: 120, samples: 1024, field: (log2_table: 12)),
        "sync": Sync(field: "fit", images: "scene.train", low_weight: 0, steps: 20, samples: 1024),
    },
)"#;

/// A space with the training in it.
pub fn training() -> Space {
    let space = Space::new();
    fs::write(space.path("training.ron"), TRAINING).unwrap();
    space
}

pub fn run(folder: &str, more: &[&str]) -> Vec<String> {
    let store = format!("--store={folder}/store");
    let out = format!("--out={folder}/out");
    ["run", "training.ron", "--json", &store, &out]
        .iter()
        .chain(more)
        .map(ToString::to_string)
        .collect()
}

pub fn text(arguments: &[String]) -> Vec<&str> {
    arguments.iter().map(String::as_str).collect()
}

/// The checkpoint of the stage that is under way, once there is one.
pub fn checkpoint(space: &Space, store: &str) -> PathBuf {
    let mut found = None;
    wait_until("a checkpoint", || {
        found = in_work(space, store, "scratch/checkpoint");
        found.is_some()
    });
    found.unwrap()
}

/// A file of this name in the private folder of some stage that is under way.
pub fn in_work(space: &Space, store: &str, name: &str) -> Option<PathBuf> {
    let folders = fs::read_dir(space.path(store).join("work"))
        .into_iter()
        .flatten()
        .flatten();
    folders
        .map(|entry| entry.path().join(name))
        .find(|path| path.exists())
}

/// Begins a run, and ends it by a signal once it has a checkpoint.
fn cut_off(space: &Space, folder: &str, name: &str) -> Said {
    let child = space.spawn(&text(&run(folder, &["--checkpoint-every=0"])));
    checkpoint(space, &format!("{folder}/store"));
    signal(&child, name);
    Space::wait(child)
}

pub fn resumed(said: &Said) -> Vec<(String, u64, String)> {
    let events = said
        .out
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap());
    let word = |value: &Value| value.as_str().unwrap().to_owned();
    events
        .filter(|event| event["event"] == "resumed")
        .map(|event| {
            (
                word(&event["stage"]),
                event["step"].as_u64().unwrap(),
                word(&event["from"]),
            )
        })
        .collect()
}

#[test]
fn a_training_that_is_killed_goes_on_with_the_same_bits_for_any_number_of_threads() {
    let space = training();
    space.ok(&text(&run("calm", &["--threads=2"])));
    for (threads, every) in [("1", "1h"), ("7", "0")] {
        let folder = format!("threads{threads}");
        space.ok(&text(&run(
            &folder,
            &["--threads", threads, "--checkpoint-every", every],
        )));
        assert_same_files(&space, "calm/out", &format!("{folder}/out"));
    }
    for name in ["-KILL", "-TERM", "-INT", "-USR1"] {
        let folder = format!("cut{name}");
        let said = cut_off(&space, &folder, name);
        assert_eq!(
            said.code,
            if name == "-KILL" { -1 } else { 75 },
            "{name}: {}",
            said.err
        );
        let said = space.ok(&text(&run(&folder, &["--threads=7"])));
        let (stage, step, from) = resumed(&said).remove(0);
        assert_eq!(
            (stage.as_str(), from.as_str()),
            ("fit", "checkpoint"),
            "{name}"
        );
        assert!((1..=120).contains(&step), "{name}: {step}");
        assert_same_files(&space, "calm/out", &format!("{folder}/out"));
        assert!(
            fs::read_dir(space.path(&folder).join("store/work"))
                .unwrap()
                .next()
                .is_none(),
            "{name}"
        );
    }
}

#[test]
fn a_damaged_checkpoint_is_named_and_the_stage_starts_afresh() {
    let space = training();
    let damage: [fn(&Path); 2] = [
        |path| fs::write(path, "v1").unwrap(),
        |path| {
            let mut bytes = fs::read(path).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 1;
            fs::write(path, bytes).unwrap();
        },
    ];
    space.ok(&text(&run("calm", &[])));
    for (number, damage) in damage.into_iter().enumerate() {
        let folder = format!("cut{number}");
        cut_off(&space, &folder, "-KILL");
        damage(&checkpoint(&space, &format!("{folder}/store")));
        let said = space.ok(&text(&run(&folder, &[])));
        assert!(
            said.out
                .contains("checkpoint cannot be used: its content is damaged; starting afresh"),
            "{}",
            said.out
        );
        assert_eq!(resumed(&said), []);
        assert_same_files(&space, "calm/out", &format!("{folder}/out"));
    }
}

#[test]
fn people_are_told_from_which_step_a_stage_goes_on() {
    let space = training();
    cut_off(&space, "cut", "-TERM");
    let arguments = run("cut", &["--target=fit"])
        .into_iter()
        .filter(|argument| argument != "--json");
    let said = space.ok(&text(&arguments.collect::<Vec<_>>()));
    assert!(
        said.err.contains("fit: going on from step "),
        "{}",
        said.err
    );
}
