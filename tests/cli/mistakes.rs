//! Mistakes: each gives one clear error and its documented exit code, and nothing is written.

use std::fs;

use crate::space::{Said, Space, TINY};

/// Runs `tiny.ron` with a part of it replaced.
fn mistake(from: &str, to: &str, arguments: &[&str], code: i32, words: &[&str]) {
    let space = Space::new();
    assert!(TINY.contains(from));
    fs::write(space.path("tiny.ron"), TINY.replacen(from, to, 1)).unwrap();
    for command in ["plan", "run"] {
        let said = space.say(&[&[command, "tiny.ron"], arguments].concat());
        assert_eq!(said.code, code, "{to} {arguments:?}: {}", said.err);
        assert_eq!(said.out, "");
        words
            .iter()
            .for_each(|words| assert!(said.err.contains(words), "{words} is not in: {}", said.err));
        assert!(!said.err.contains("panicked"), "{}", said.err);
    }
    let left: Vec<_> = fs::read_dir(space.path("."))
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    assert_eq!(left, ["tiny.ron"]);
}

#[test]
fn mistakes_in_the_pipeline_are_shown_in_their_line() {
    let file = |from, to, words: &[&str]| mistake(from, to, &[], 3, words);
    file(
        "Interpolate(",
        "Interpolat(",
        &[
            "tiny.ron:5:15",
            "`Interpolat`",
            "did you mean `Interpolate`?",
        ],
    );
    file(
        "factor: 2",
        "facto: 2",
        &["tiny.ron:5:50", "`facto`", "did you mean `factor`?"],
    );
    file(
        "\"scene.train\"",
        "\"scenes.train\"",
        &["tiny.ron:5:35", "did you mean `scene`?"],
    );
    file(
        "\"scene.train\"",
        "\"scene.trains\"",
        &["tiny.ron:5:35", "did you mean `train`?"],
    );
    file("factor: 2", "factor: \"two\"", &["tiny.ron:5:"]);
    file("factor: 2", "factor: 0", &["tiny.ron:5:58", "`factor`"]);
    file("(32, 24)", "(0, 24)", &["tiny.ron:4:", "size"]);
    file(
        "Interpolate(images: \"up\", factor: 2)",
        "Rounds(count: 0, stages: {})",
        &["tiny.ron:6:32", "`count` is 0"],
    );
    file("\"again\"", "\"up\"", &["`up` is defined twice"]);
    file("},\n)", "", &["tiny.ron:"]);
    file("(32, 24)", "(32, 24", &["tiny.ron:4:"]);
}

#[test]
fn what_the_pipeline_names_must_be_there() {
    mistake(
        "Procedural(views: 3, size: (32, 24), samples: 1)",
        "Llff(path: \"nowhere\")",
        &[],
        3,
        &["scene", "nowhere"],
    );
}

#[test]
fn mistakes_on_the_command_line_are_usage_errors() {
    let option = |arguments: &[&str], words: &[&str]| mistake("", "", arguments, 2, words);
    option(
        &["--set", "up.facto=2"],
        &["--set:1:4", "did you mean `factor`?"],
    );
    option(
        &["--set", "up.factor=x("],
        &["--set:1:", "the value is not RON"],
    );
    option(&["--set", "up.factor=\"two\""], &["--set:1:11", "`factor`"]);
    option(&["--set", "up.factor=0"], &["--set:1:11", "`factor`"]);
    option(
        &["--target", "agan"],
        &["no stage `agan`", "did you mean `again`?"],
    );
    option(&["--force", "u"], &["no stage `u`"]);
    option(&["--device", "abacus"], &["there is no device `abacus`"]);
    option(&["--nonsense"], &["--nonsense"]);
}

#[test]
fn a_pipeline_that_is_not_there_is_said_to_be_so() {
    let said = Space::new().say(&["run", "other.ron"]);
    assert_eq!(said.code, 3);
    assert!(
        said.err.contains("cannot read the pipeline other.ron"),
        "{}",
        said.err
    );
}

#[test]
fn a_pipeline_without_end_is_not_read_to_the_end() {
    let space = Space::new();
    fs::File::create(space.path("endless.ron"))
        .unwrap()
        .set_len(1 << 40)
        .unwrap();
    let said = space.say(&["run", "endless.ron"]);
    assert_eq!(said.code, 3);
    assert!(
        said.err
            .contains("cannot read the pipeline endless.ron: it has more than 64 MiB"),
        "{}",
        said.err
    );
}

#[test]
fn help_lists_the_exit_codes() {
    let said = Space::new().ok(&["--help"]);
    for code in ["0 ", "1 ", "2 ", "3 ", "4 ", "75 ", "101 "] {
        assert!(
            said.out.contains(&format!("\n  {code}")),
            "{code} is not in: {}",
            said.out
        );
    }
}

#[test]
fn files_that_cannot_be_read_are_said_to_be_so() {
    let space = Space::new();
    fs::write(space.path("cut.exr"), "v/1").unwrap();
    fs::write(space.path("cut.safetensors"), [255; 9]).unwrap();
    fs::write(space.path("cut.json"), "{").unwrap();
    for name in [
        "cut.exr",
        "cut.safetensors",
        "cut.json",
        "gone.exr",
        "tiny.ron",
    ] {
        let said = space.say(&["inspect", name]);
        assert_eq!(said.code, 2, "{name}: {}", said.err);
        assert!(
            said.err.contains(name) && !said.err.contains("panicked"),
            "{}",
            said.err
        );
    }
}

/// `/dev/full` answers every write as a full disk does.
#[cfg(target_os = "linux")]
#[test]
fn an_output_on_a_full_disk_is_said_to_lack_lines_and_a_log_there_stops_nothing() {
    let full = || fs::File::options().write(true).open("/dev/full").unwrap();
    let space = Space::new();
    let said = Said::new(
        space
            .command(&["run", "tiny.ron", "--json"])
            .stdout(full())
            .output()
            .unwrap(),
    );
    assert_eq!(said.code, 4, "{}", said.err);
    assert!(
        said.err
            .contains("standard output is not complete: No space left on device"),
        "{}",
        said.err
    );
    // The run itself came to its end.
    let said = Said::new(
        space
            .command(&["plan", "tiny.ron", "--exit-code"])
            .stderr(full())
            .output()
            .unwrap(),
    );
    assert_eq!(said.code, 0, "{}", said.out);
    for (arguments, code) in [
        (&["run", "tiny.ron"][..], 0),
        (&["run", "tiny.ron", "--salt", "a"], 0),
        (&["run", "other.ron"], 3),
    ] {
        let said = Said::new(space.command(arguments).stderr(full()).output().unwrap());
        assert_eq!(said.code, code, "{arguments:?}: {}", said.out);
    }
}
