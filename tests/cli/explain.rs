//! Why does it run, what will run, what is different: answers that must agree with what then
//! happens.

use serde_json::{Value, json};

use crate::space::Space;

/// What `plan --json` says of a stage.
fn state(plan: &Value, stage: &str) -> String {
    let stages = plan["stages"].as_array().unwrap();
    stages.iter().find(|entry| entry["stage"] == stage).unwrap()["state"]
        .as_str()
        .unwrap()
        .to_owned()
}

#[test]
fn a_plan_tells_scripts_whether_there_is_something_to_run() {
    let space = Space::new();
    let new = space.say(&["plan", "tiny.ron", "--exit-code"]);
    assert_eq!(new.code, 5);
    assert!(new.err.contains("3 of 3 stages to run"), "{}", new.err);
    space.ok(&["run", "tiny.ron"]);
    space.ok(&["plan", "tiny.ron", "--exit-code"]);
    assert_eq!(
        space
            .say(&["plan", "tiny.ron", "--exit-code", "--force", "up"])
            .code,
        5
    );
    space.ok(&["plan", "tiny.ron", "--force", "up"]);
}

/// Forcing a stage gives the result that it gave before: the plan says that what follows may be
/// spared, and it is.
#[test]
fn what_an_unchanged_result_may_spare_is_foretold_and_spared() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let plan = space
        .ok(&["plan", "tiny.ron", "--force", "up", "--json"])
        .json();
    assert_eq!(
        ["scene", "up", "again"].map(|stage| state(&plan, stage)),
        ["cached", "will_run", "may_be_spared"]
    );
    let run = space
        .ok(&["run", "tiny.ron", "--force", "up", "--json"])
        .last();
    assert_eq!(
        (&run["ran"], &run["cached"]),
        (&json!(["up"]), &json!(["again", "scene"]))
    );
}

/// The plan before each of several edits, and what the run did.
#[test]
fn the_plan_is_what_the_run_then_does() {
    let space = Space::new();
    for set in [
        "seed=0",
        "up.filter=Lanczos",
        "again.factor=3",
        "scene.holdout=3",
        "up.filter=Bicubic",
        "seed=0",
    ] {
        let arguments = ["tiny.ron", "--set", set, "--json"];
        let plan = space.ok(&[&["plan"], &arguments[..]].concat()).json();
        let ran = space.ok(&[&["run"], &arguments[..]].concat()).last()["ran"].clone();
        for stage in ["scene", "up", "again"] {
            let planned = state(&plan, stage);
            let ran = ran.as_array().unwrap().contains(&json!(stage));
            assert!(
                planned == "may_be_spared" || (planned == "will_run") == ran,
                "{set}: {stage}: {planned}, {ran}"
            );
        }
    }
}

#[test]
fn explaining_a_stage_names_the_first_cause_even_before_its_key_is_known() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let set = ["--set", "up.filter=Lanczos"];
    let before = space
        .ok(&[&["explain", "again", "tiny.ron"], &set[..]].concat())
        .out;
    assert!(
        before.starts_with("again: it will run after up, unless that changes nothing\n"),
        "{before}"
    );
    assert!(
        before.contains("first cause: up: params changed: `filter` \"Bicubic\" -> \"Lanczos\"\n"),
        "{before}"
    );
    space.ok(&[&["run", "tiny.ron"], &set[..]].concat());
    let after = space
        .ok(&[&["explain", "again", "tiny.ron", "--json"], &set[..]].concat())
        .json();
    assert_eq!(
        after["first_cause"],
        json!({"stage": "up", "why": "`filter` \"Bicubic\" -> \"Lanczos\""})
    );
    assert_eq!(after["changes"][0]["path"], "inputs.images");
    assert_eq!(after["changes"][0]["from"], "up");
}

#[test]
fn each_event_of_a_stage_that_runs_has_its_reason() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let said = space
        .ok(&["run", "tiny.ron", "--json", "--set", "up.filter=Lanczos"])
        .out;
    let events: Vec<Value> = said
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let started: Vec<_> = events
        .iter()
        .filter(|event| event["event"] == "started")
        .map(|e| &e["reason"])
        .collect();
    assert_eq!(
        started,
        [
            "params changed: `filter` \"Bicubic\" -> \"Lanczos\"",
            "input `images` (of up) changed"
        ]
        .map(Value::from)
        .iter()
        .collect::<Vec<_>>()
    );
}

#[test]
fn two_runs_two_results_and_two_pipelines_are_compared_alike() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    space.ok(&["run", "tiny.ron", "--set", "up.filter=Lanczos"]);
    let key = |set: &[&str]| {
        let record = space
            .ok(&[&["inspect", "again", "tiny.ron", "--json"], set].concat())
            .json();
        record["key"].as_str().unwrap()[..12].to_owned()
    };
    let old = key(&[]);
    let new = key(&["--set", "up.filter=Lanczos"]);
    let pipelines = ["tiny.ron", "--set", "up.filter=Lanczos"];
    for operands in [&[][..], &["@2", "@1"], &[&old, &new], &pipelines] {
        let said = space.ok(&[&["diff"], operands].concat()).out;
        let line = said
            .lines()
            .find(|line| line.starts_with("up "))
            .unwrap_or_else(|| panic!("{operands:?}: {said}"));
        assert!(
            line.ends_with("`filter` \"Bicubic\" -> \"Lanczos\""),
            "{operands:?}: {said}"
        );
        assert!(said.contains("follows up\n"), "{operands:?}: {said}");
        assert!(
            said.contains("3 stages: 1 differ by themselves, 1 follow\n"),
            "{operands:?}: {said}"
        );
    }
    assert_eq!(space.say(&["diff", "@2", "@1", "--exit-code"]).code, 5);
    assert_eq!(space.say(&["diff", "@1", "@1", "--exit-code"]).code, 0);
    let changed = space.ok(&["diff", "tiny.ron", "--json"]).json();
    assert_eq!(
        changed["stages"][2],
        json!({"stage": "up", "state": "differs", "changes": [
        {"path": "params.filter", "before": "\"Lanczos\"", "now": "\"Bicubic\""}]})
    );
    assert_eq!(space.say(&["diff", "nonsense"]).code, 2);
}
