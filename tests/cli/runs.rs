//! Running, planning, explaining and looking at results.

use serde_json::json;

use crate::space::Space;

#[test]
fn a_second_run_runs_nothing_and_takes_no_time() {
    let space = Space::new();
    let first = space.ok(&["run", "tiny.ron", "--json"]).last();
    assert_eq!(first["event"], "finished");
    assert_eq!(
        (&first["ran"], &first["cached"], &first["failed"]),
        (&json!(["again", "scene", "up"]), &json!([]), &json!([]))
    );
    let second = space.ok(&["run", "tiny.ron", "--json"]).last();
    assert_eq!(
        (&second["ran"], &second["cached"]),
        (&json!([]), &json!(["again", "scene", "up"]))
    );
    assert!(second["seconds"].as_f64().unwrap() < 1.0);
}

#[test]
fn a_changed_value_runs_what_depends_on_it_as_the_plan_said() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let set = ["--set", "up.filter=Lanczos"];
    let plan = space.ok(&[&["plan", "tiny.ron"], &set[..]].concat());
    let lines: Vec<String> = plan
        .out
        .lines()
        .map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "))
        .collect();
    assert_eq!(lines[0], "scene cached");
    // How long they take, and with how much memory, differs from run to run.
    let is = |line: &str, takes: &str, why: &str| line.starts_with(takes) && line.ends_with(why);
    assert!(
        is(
            &lines[1],
            "up will run ~",
            " MB params changed: `filter` \"Bicubic\" -> \"Lanczos\""
        ),
        "{}",
        lines[1]
    );
    assert!(
        is(
            &lines[2],
            "again will run ",
            " MB upstream up will run (spared if its result is unchanged)"
        ),
        "{}",
        lines[2]
    );
    let run = space.ok(&[&["run", "tiny.ron"], &set[..]].concat());
    assert!(run.err.contains("scene: cached\n"), "{}", run.err);
    assert!(
        run.err
            .contains("up: running (params changed: `filter` \"Bicubic\" -> \"Lanczos\")\n"),
        "{}",
        run.err
    );
    assert!(
        run.err
            .contains("again: running (input `images` (of up) changed)\n"),
        "{}",
        run.err
    );
    assert!(run.err.contains("2 stages ran, 1 cached"), "{}", run.err);
    let explained = space
        .ok(&[&["explain", "again", "tiny.ron"], &set[..]].concat())
        .out;
    assert!(
        explained.contains("params.factor           2.0\n"),
        "{explained}"
    );
    assert!(
        explained.contains("first cause: up: `filter` \"Bicubic\" -> \"Lanczos\"\n"),
        "{explained}"
    );
    assert_eq!(
        space.ok(&["run", "tiny.ron", "--json"]).last()["ran"],
        json!([])
    );
}

#[test]
fn targets_and_forced_stages_are_names_of_stages() {
    let space = Space::new();
    assert_eq!(
        space
            .ok(&["run", "tiny.ron", "--json", "--target", "up"])
            .last()["ran"],
        json!(["scene", "up"])
    );
    let forced = space
        .ok(&["run", "tiny.ron", "--json", "--force", "up"])
        .last();
    assert_eq!(
        (&forced["ran"], &forced["cached"]),
        (&json!(["again", "up"]), &json!(["scene"]))
    );
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let space = Space::new();
    for threads in ["1", "2", "5"] {
        space.ok(&[
            "run",
            "tiny.ron",
            "--threads",
            threads,
            "--store",
            &format!("s{threads}"),
            "--out",
            &format!("o{threads}"),
        ]);
    }
    let one = space.files("o1");
    assert!(one.len() > 6);
    space.assert_files("o2", &one);
    space.assert_files("o5", &one);
}

#[test]
fn a_salt_sets_results_apart() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    assert_eq!(
        space
            .ok(&["run", "tiny.ron", "--json", "--salt", "s"])
            .last()["cached"],
        json!([])
    );
}

#[test]
fn files_and_stages_say_what_they_are() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let stage = space.ok(&["inspect", "up", "tiny.ron"]).out;
    assert!(
        stage.contains("images: images, ") && stage.contains("view_001.exr"),
        "{stage}"
    );
    let image = space
        .ok(&["inspect", "out/tiny/up/images/view_001.exr"])
        .out;
    assert!(
        image.contains("worldToCamera") && image.contains("24x32"),
        "{image}"
    );
    let json = space
        .ok(&["inspect", "out/tiny/up/images/view_001.exr", "--json"])
        .json();
    assert_eq!(json["arrays"][0]["shape"], json!([24, 32]));
    let cameras = space
        .ok(&["inspect", "out/tiny/up/images/transforms.json"])
        .out;
    assert!(cameras.contains("frames"), "{cameras}");
}

#[test]
fn metrics_of_a_run_without_any_are_none() {
    let space = Space::new();
    assert_eq!(space.say(&["metrics"]).code, 2);
    space.ok(&["run", "tiny.ron"]);
    assert_eq!(
        space.ok(&["metrics", "--json"]).json()["metrics"],
        json!([])
    );
}

#[test]
fn events_come_one_a_line_and_nothing_else_does() {
    let space = Space::new();
    let said = space.ok(&["run", "tiny.ron", "--json"]);
    let events: Vec<serde_json::Value> = said
        .out
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let of = |name: &str| events.iter().filter(|event| event["event"] == name).count();
    assert_eq!(
        (of("started"), of("stage_finished"), of("finished")),
        (3, 3, 1)
    );
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let space = Space::new();
    let mut child = space.spawn(&["run", "tiny.ron", "--json"]);
    drop(child.stdout.take());
    let said = Space::wait(child);
    assert_eq!((said.code, said.err.as_str()), (0, ""));
}
