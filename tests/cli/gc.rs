//! `gc`, `pin` and `store du`: the space that results take, measured and given back without harm.

use std::fs::{self, File};
use std::time::{Duration, SystemTime};

use serde_json::{Value, json};

use crate::space::Space;

/// Three runs of `tiny.ron`, each with another filter of `up`.
fn three_runs() -> Space {
    let space = Space::new();
    for filter in ["Lanczos", "Nearest", "Bicubic"] {
        space.ok(&["run", "tiny.ron", "--set", &format!("up.filter={filter}")]);
    }
    space
}

fn ran(space: &Space, filter: &str) -> Value {
    space
        .ok(&[
            "run",
            "tiny.ron",
            "--json",
            "--set",
            &format!("up.filter={filter}"),
        ])
        .last()["ran"]
        .clone()
}

fn stages(gc: &Value) -> Vec<&str> {
    let mut stages: Vec<&str> = gc["results"]
        .as_array()
        .unwrap()
        .iter()
        .map(|result| result["stage"].as_str().unwrap())
        .collect();
    stages.sort_unstable();
    stages
}

#[test]
fn gc_says_what_would_go_and_removes_nothing_unless_told_to() {
    let space = three_runs();
    let before = space.files(".srnerf");
    let said = space.ok(&["gc", "--keep-last", "1"]).out;
    assert!(
        said.contains("no run kept and no pin needs it")
            && said.contains("; gc --delete removes them"),
        "{said}"
    );
    space.assert_files(".srnerf", &before);
    assert_eq!(
        stages(&space.ok(&["gc", "--json"]).json()),
        [""; 0],
        "all three runs are kept by default"
    );
    let gone = space
        .ok(&["gc", "--keep-last", "1", "--delete", "--json"])
        .json();
    assert_eq!(stages(&gone), ["again", "again", "up", "up"]);
    assert_eq!(
        space.ok(&["store", "fsck", "--json"]).json()["findings"],
        json!([])
    );
    assert_eq!(ran(&space, "Bicubic"), json!([]));
    assert_eq!(ran(&space, "Nearest"), json!(["again", "up"]));
}

#[test]
fn pins_keep_results_until_they_are_taken_away() {
    let space = three_runs();
    assert_eq!(space.ok(&["pin"]).out, "no pins\n");
    assert!(
        space
            .ok(&["pin", "paper", "--run", "@3"])
            .out
            .starts_with("paper: 3 results of tiny at ")
    );
    space.ok(&["gc", "--keep-last", "1", "--delete"]);
    assert_eq!(ran(&space, "Lanczos"), json!([]));
    assert_eq!(ran(&space, "Nearest"), json!(["again", "up"]));
    space.ok(&["unpin", "paper"]);
    assert_eq!(space.say(&["unpin", "paper"]).code, 2);
    // No name leads to a file elsewhere in the store.
    let run = fs::read_dir(space.path(".srnerf/runs"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let outside = format!("../runs/{}", run.file_stem().unwrap().to_str().unwrap());
    let said = space.say(&["unpin", &outside]);
    assert!(said.code == 2 && run.exists(), "{}", said.err);
    assert_eq!(
        stages(&space.ok(&["gc", "--keep-last", "1", "--json"]).json()).len(),
        4
    );
    assert_eq!(space.say(&["pin", "../up"]).code, 2);
}

#[test]
fn what_was_used_lately_stays_and_what_was_not_used_for_longest_goes_first() {
    let space = three_runs();
    assert_eq!(
        stages(
            &space
                .ok(&["gc", "--keep-last", "1", "--older-than", "1h", "--json"])
                .json()
        ),
        [""; 0]
    );
    // Room for two of the three results of `again`, which are the largest.
    let usage = space.ok(&["store", "du", "--json"]).json();
    let of = |stage: &str| {
        let stages = usage["stages"].as_array().unwrap();
        stages.iter().find(|entry| entry["stage"] == stage).unwrap()["bytes"]
            .as_u64()
            .unwrap()
    };
    let room = usage["total"].as_u64().unwrap() - of("again") / 2;
    let gone = space
        .ok(&["gc", "--max-size", &room.to_string(), "--json"])
        .json();
    assert!(gone["stays"].as_u64().unwrap() <= room);
    let too_small = space.say(&["gc", "--max-size", "1kB"]);
    assert_eq!(too_small.code, 5, "{}", too_small.out);
    assert!(
        too_small
            .err
            .contains("the last run of each pipeline and pins are never removed"),
        "{}",
        too_small.err
    );
    space.say(&["gc", "--max-size", "1kB", "--delete"]);
    assert_eq!(ran(&space, "Bicubic"), json!([]));
}

#[test]
fn gc_waits_for_nobody_and_removes_nothing_while_someone_uses_the_store() {
    let space = three_runs();
    let lock = File::open(space.path(".srnerf/lock")).unwrap();
    lock.lock_shared().unwrap();
    let said = space.say(&["gc", "--keep-last", "1", "--delete"]);
    assert_eq!(said.code, 4);
    assert!(
        said.err.contains("another process uses .srnerf"),
        "{}",
        said.err
    );
    space.ok(&["gc", "--keep-last", "1"]);
    drop(lock);
    space.ok(&["gc", "--keep-last", "1", "--delete"]);
}

/// Results go before blobs: a store in which only some results are gone, or all of them and some
/// blobs, is sound.
#[test]
fn a_gc_that_is_cut_off_leaves_a_sound_store() {
    let space = three_runs();
    let doomed = space.ok(&["gc", "--keep-last", "1", "--json"]).json();
    for result in doomed["results"].as_array().unwrap() {
        let key = result["key"].as_str().unwrap();
        fs::remove_file(space.path(&format!(".srnerf/results/{}/{key}.json", &key[..2]))).unwrap();
        space.ok(&["store", "fsck"]);
    }
    for blob in space.files(".srnerf/cas").into_keys() {
        let path = space.path(".srnerf/cas").join(blob);
        File::options()
            .write(true)
            .open(&path)
            .unwrap()
            .set_modified(SystemTime::now() - Duration::from_secs(7200))
            .unwrap();
    }
    let rest = space.ok(&["gc", "--delete", "--json"]).json();
    assert!(stages(&rest).is_empty() && rest["blobs"].as_u64().unwrap() > 0);
    space.ok(&["store", "fsck"]);
    assert_eq!(ran(&space, "Bicubic"), json!([]));
}

#[test]
fn du_tells_what_is_shared_from_what_is_not() {
    let space = three_runs();
    let text = fs::read_to_string(space.path("tiny.ron"))
        .unwrap()
        .replacen("\"tiny\"", "\"twin\"", 1);
    fs::write(
        space.path("twin.ron"),
        text.replace("factor: 2),\n    }", "factor: 3),\n    }"),
    )
    .unwrap();
    space.ok(&["run", "twin.ron"]);
    let usage = space.ok(&["store", "du", "--json"]).json();
    let own = |pipeline: &str, stage: &str| {
        let entry = usage["stages"]
            .as_array()
            .unwrap()
            .iter()
            .find(|e| e["pipeline"] == pipeline && e["stage"] == stage);
        (
            entry.unwrap()["bytes"].as_u64().unwrap(),
            entry.unwrap()["own"].as_u64().unwrap(),
        )
    };
    assert_eq!(own("tiny", "up"), own("twin", "up"), "one result, shared");
    assert_ne!(own("tiny", "again").0, own("twin", "again").0);
    let whole = &usage["pipelines"]["twin"]["bytes"];
    let alone = &usage["pipelines"]["twin"]["own"];
    assert_eq!(alone.as_u64().unwrap(), own("twin", "again").1, "{whole}");
    assert!(usage["other_results"]["bytes"].as_u64().unwrap() > 0);
    let text = space.ok(&["store", "du"]).out;
    assert!(
        text.contains("\ntwin ") && text.contains("\n  again ") && text.contains("\ntotal "),
        "{text}"
    );
}
