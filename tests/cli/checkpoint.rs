//! A training cut off in the middle goes on where it was, and ends with the bits of one that was
//! left alone.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::space::{Said, Space, assert_same_files, signal, wait_until};
use crate::whole::{SHORT, pipeline};

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
fn training() -> Space {
    let space = Space::new();
    fs::write(space.path("training.ron"), TRAINING).unwrap();
    space
}

fn run(folder: &str, more: &[&str]) -> Vec<String> {
    let store = format!("--store={folder}/store");
    let out = format!("--out={folder}/out");
    ["run", "training.ron", "--json", &store, &out]
        .iter()
        .chain(more)
        .map(ToString::to_string)
        .collect()
}

fn text(arguments: &[String]) -> Vec<&str> {
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
    let calm = space.files("calm/out");
    for (threads, every) in [("1", "1h"), ("7", "0")] {
        let folder = format!("threads{threads}");
        space.ok(&text(&run(
            &folder,
            &["--threads", threads, "--checkpoint-every", every],
        )));
        space.assert_files(&format!("{folder}/out"), &calm);
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
        space.assert_files(&format!("{folder}/out"), &calm);
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

#[test]
fn more_steps_go_on_from_a_finished_result_where_they_can() {
    let space = training();
    let more = ["--set=fit.steps=170", "--set=fit.final_rate=1"];
    space.ok(&text(&run("straight", &more)));
    space.ok(&text(&run("grown", &["--set=fit.final_rate=1"])));
    let said = space.ok(&text(&run("grown", &more)));
    assert_eq!(
        resumed(&said),
        [("fit".to_owned(), 120, "result".to_owned())]
    );
    assert_same_files(&space, "straight/out", "grown/out");
    assert_eq!(space.files("grown/store/states").len(), 1);
    let said = space.ok(&text(&run(
        "grown",
        &[&more[..], &["--force=fit"]].concat(),
    )));
    assert_eq!(
        resumed(&said),
        [],
        "who forces a stage wants all of it computed"
    );
}

/// A state is there for longer runs, for as long as there is a result for them to go on from.
#[test]
fn a_state_is_counted_and_goes_with_its_result() {
    let space = training();
    let fit = |more: &[&str]| {
        run(
            "a",
            &[&["--target=fit", "--set=fit.final_rate=1"], more].concat(),
        )
    };
    for seed in ["--set=seed=1", "--set=seed=2"] {
        space.ok(&text(&fit(&[seed])));
    }
    let states = || space.files("a/store/states");
    assert_eq!(states().len(), 2);
    let fsck = space.ok(&["store", "fsck", "--json", "--store=a/store"]);
    assert_eq!(fsck.json()["findings"], json!([]));
    let du = space
        .ok(&["store", "du", "--json", "--store=a/store"])
        .json();
    let bytes: usize = states().values().map(Vec::len).sum();
    assert_eq!(du["rest"]["states for longer runs"], json!(bytes));
    space.ok(&["gc", "--keep-last=1", "--delete", "--store=a/store"]);
    assert_eq!(states().len(), 1);
    let longer = space.ok(&text(&fit(&["--set=seed=2", "--set=fit.steps=170"])));
    assert_eq!(
        resumed(&longer),
        [("fit".to_owned(), 120, "result".to_owned())]
    );
}

#[test]
fn a_synchronisation_goes_on_from_a_finished_one() {
    let space = training();
    let grown = |steps: &'static str| ["--set=sync.final_rate=1", steps];
    space.ok(&text(&run("straight", &grown("--set=sync.steps=35"))));
    space.ok(&text(&run("grown", &grown("--set=sync.steps=20"))));
    let said = space.ok(&text(&run("grown", &grown("--set=sync.steps=35"))));
    assert_eq!(
        resumed(&said),
        [("sync".to_owned(), 20, "result".to_owned())]
    );
    assert_same_files(&space, "straight/out", "grown/out");
}

#[test]
fn an_optimisation_goes_on_from_a_finished_one_unless_its_timesteps_fall() {
    let space = Space::new();
    let smoke = pipeline("smoke");
    let target = "--target=i3ds.1.optimize";
    let run = |folder: &str, rule: &str, steps: u32| {
        let store = format!("--store={folder}/store");
        let out = format!("--out={folder}/out");
        let rule = format!("--set=i3ds.optimize.guidance={rule}");
        let steps = format!("--set=i3ds.optimize.steps={steps}");
        let warm_up = |set: &&&str| !set.contains("warm_up");
        let short: Vec<&str> = SHORT.iter().filter(warm_up).copied().collect();
        space.ok(&[
            &["run", &smoke, "--json", target, &store, &out],
            &short[..],
            &[&rule, &steps],
        ]
        .concat())
    };
    let vsd = "Vsd(lora_every: 3, warm_up: 1, timesteps: Uniform(min: 0.02, max: 0.98))";
    run("straight", vsd, 7);
    run("grown", vsd, 4);
    // The step before the first moves the LoRA alone.
    assert_eq!(
        resumed(&run("grown", vsd, 7)),
        [("i3ds.1.optimize".to_owned(), 5, "result".to_owned())]
    );
    assert_same_files(&space, "straight/out", "grown/out");
    run("grown", "Rsd()", 4);
    let said = run("grown", "Rsd()", 7);
    assert!(
        said.out
            .contains("from the first step, since its timesteps fall over all steps"),
        "{}",
        said.out
    );
    assert_eq!(resumed(&said), []);
}

#[test]
fn where_a_step_depends_on_their_number_more_steps_begin_at_the_first_and_it_is_said_why() {
    let space = training();
    space.ok(&text(&run("grown", &["--target=fit"])));
    let said = space.ok(&text(&run(
        "grown",
        &["--target=fit", "--set=fit.steps=170"],
    )));
    assert!(
        said.out
            .contains("`steps` 120 -> 170; from the first step, since the learning rate falls"),
        "{}",
        said.out
    );
    assert_eq!(resumed(&said), []);
}
