//! What stages are expected to take, and runs that are refused for it.

use std::fs;
use std::path::PathBuf;

use serde_json::{Value, json};

use crate::space::{Said, Space};

/// What the plan expects of a stage.
fn expected(space: &Space, stage: &str, more: &[&str]) -> Value {
    let plan = space
        .ok(&[&["plan", "tiny.ron", "--json"], more].concat())
        .json();
    let stages = plan["stages"].as_array().unwrap();
    let found = stages.iter().find(|one| one["stage"] == stage).unwrap();
    found["expected"].clone()
}

#[test]
fn the_first_time_is_a_guess_and_then_results_tell() {
    let space = Space::new();
    assert_eq!(expected(&space, "up", &[])["from"], "estimate");
    assert_eq!(expected(&space, "scene", &[])["from"], "estimate");
    let said = space.ok(&["plan", "tiny.ron"]);
    assert!(said.out.contains("guess "), "{}", said.out);
    space.ok(&["run", "tiny.ron", "--target=up"]);
    let again = expected(&space, "again", &[]);
    assert_eq!(
        (&again["from"], &again["of"]),
        (&json!("result"), &json!("up")),
        "{again}"
    );
    let forced = expected(&space, "up", &["--force=up"]);
    assert_eq!(forced["from"], "result", "{forced}");
    assert!(forced["memory"].as_u64().unwrap() > 1 << 20, "{forced}");
    let other = expected(&space, "up", &["--set=up.filter=Lanczos"]);
    assert_eq!(
        (&other["from"], &other["but"]),
        (&json!("like_result"), &json!(["filter"])),
        "{other}"
    );
    // Nothing to run takes nothing.
    let said = space.ok(&["plan", "tiny.ron", "--target=up"]);
    assert!(!said.out.contains("one after the other"), "{}", said.out);
}

#[test]
fn time_is_in_proportion_to_steps() {
    let space = Space::new();
    let fit = |steps: u32| {
        format!(
            "(name: \"tiny\", stages: {{ \"scene\": Scene(source: Procedural(views: 3, size: (32, 24), samples: 1), downscale: 1, holdout: 2), \
             \"fit\": Fit(images: \"scene.train\", steps: {steps}, samples: 1024) }})"
        )
    };
    fs::write(space.path("tiny.ron"), fit(10)).unwrap();
    space.ok(&["run", "tiny.ron"]);
    let took = expected(&space, "fit", &["--force=fit"])["seconds"]
        .as_f64()
        .unwrap();
    fs::write(space.path("tiny.ron"), fit(30)).unwrap();
    let longer = expected(&space, "fit", &[])["seconds"].as_f64().unwrap();
    assert!(
        (longer - 3.0 * took).abs() < 1e-9 * longer,
        "{took} {longer}"
    );
}

/// The record of a stage's result.
fn record(space: &Space, stage: &str) -> (PathBuf, Value) {
    let files = space.files(".srnerf/results");
    let mut records = files.into_iter().filter_map(|(path, bytes)| {
        let record: Value = serde_json::from_slice(&bytes).ok()?;
        (record["stage"] == stage).then_some((path, record))
    });
    records.next().unwrap()
}

#[test]
fn what_needs_more_memory_than_there_is_does_not_begin() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let (path, mut told) = record(&space, "up");
    told["peak_memory"] = json!(1u64 << 60);
    let path = space.path(".srnerf/results").join(path);
    fs::remove_file(&path).unwrap();
    fs::write(&path, told.to_string()).unwrap();
    // What is there needs no memory.
    space.ok(&["run", "tiny.ron"]);
    let other = "--set=up.filter=Lanczos";
    let words = |said: &Said| {
        let words = said.err.split_whitespace().filter(|word| *word != "│");
        words.collect::<Vec<_>>().join(" ")
    };
    let said = space.say(&["run", "tiny.ron", other]);
    assert_eq!(said.code, 3, "{}", said.err);
    let told = words(&said);
    for part in [
        "`up` is expected to need 1152921504.6 GB of memory (`up`, with another filter, took so much)",
        "nothing was run",
        "--over-memory",
    ] {
        assert!(told.contains(part), "{part} is not in {told}");
    }
    assert!(!said.err.contains("running"), "{}", said.err);
    let said = space.ok(&["run", "tiny.ron", other, "--over-memory"]);
    assert!(said.err.contains("2 stages ran, 1 cached"), "{}", said.err);
}

/// A field of so many drawn photos at this size, half of them held out.
fn field_of(space: &Space, views: u32, [width, height]: [u32; 2]) {
    let text = format!(
        "(name: \"tiny\", stages: {{ \"scene\": Scene(source: Procedural(views: {views}, size: ({width}, {height})), downscale: 1, holdout: 2), \
         \"up\": Interpolate(images: \"scene.train\", factor: 2), \"fit\": Fit(images: \"up\") }})"
    );
    fs::write(space.path("tiny.ron"), text).unwrap();
}

#[test]
fn what_is_not_computed_yet_has_its_size_by_the_photos() {
    let space = Space::new();
    let memory = |views| {
        field_of(&space, views, [320, 240]);
        expected(&space, "fit", &[])["memory"].as_u64().unwrap()
    };
    // Photos to train on stay in memory, 12 to 16 bytes a pixel: fifty more, enlarged.
    let more = memory(110) - memory(10);
    assert!(more > 50 * 640 * 480 * 12, "{more}");
    assert!(!space.path(".srnerf").join("results").exists());
}

#[test]
fn a_part_is_foretold_by_its_own_views() {
    let space = Space::new();
    field_of(&space, 110, [320, 240]);
    let seconds = |stage, more: &[&str]| expected(&space, stage, more)["seconds"].as_f64().unwrap();
    let sharded = ["--set=up.shards=5"];
    // A second goes to any stage, and the rest to its views: 55, or 11.
    let whole = seconds("up", &[]) - 1.0;
    let part = seconds("up.1", &sharded) - 1.0;
    assert!((whole - 5.0 * part).abs() < 1e-6 * whole, "{whole} {part}");
    // Together they leave what the whole would.
    let memory = |more: &[&str]| expected(&space, "fit", more)["memory"].clone();
    assert_eq!(memory(&sharded), memory(&[]));
}

#[test]
fn a_scene_too_large_for_memory_is_refused_before_anything_is_drawn() {
    let space = Space::new();
    field_of(&space, 10_000, [16_000, 12_000]);
    let said = space.say(&["run", "tiny.ron"]);
    assert_eq!(said.code, 3, "{}", said.err);
    assert!(
        said.err.contains("`scene` is expected to need"),
        "{}",
        said.err
    );
    assert!(!said.err.contains("running"), "{}", said.err);
}
