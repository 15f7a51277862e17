//! Killed, stopped, damaged: the next run is right without anyone's help.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::json;

use crate::checkpoint::in_work;
use crate::cut::cut_after;
use crate::files::assert_same_files;
use crate::space::{Said, Space, signal, wait_until};

/// As `tiny.ron`, but with enough to draw that there is time to be killed.
const SLOW: [&str; 4] = [
    "run",
    "tiny.ron",
    "--set",
    "scene.source=Procedural(views: 6, size: (192, 144), samples: 4)",
];

fn slow(space: &Space, folder: &str) -> Said {
    space.ok(&[
        &SLOW[..],
        &[
            "--json",
            "--store",
            &format!("{folder}/store"),
            "--out",
            &format!("{folder}/out"),
        ],
    ]
    .concat())
}

#[test]
fn killed_at_any_moment_a_run_loses_nothing_and_ends_as_if_undisturbed() {
    let space = Space::new();
    slow(&space, "calm");
    let arguments = [&SLOW[..], &["--store", "wild/store", "--out", "wild/out"]].concat();
    // At once, then after 1, 2, 4, 8 … files, until a run has come to its end.
    let moments = std::iter::once(0).chain((0..).map(|doubled| 1 << doubled));
    let mut kills = 0;
    for files in moments {
        let said = cut_after(files, "-KILL", "wild", &space, &arguments);
        if said.code == 0 {
            break;
        }
        assert_eq!(said.code, -1, "{}", said.err);
        kills += 1;
    }
    assert!(kills > 2, "runs ended before they were killed: {kills}");
    slow(&space, "wild");
    assert_same_files(&space, "calm/out", "wild/out");
    assert_eq!(
        fs::read_dir(space.path("wild/store/work"))
            .unwrap()
            .filter(|e| e.as_ref().unwrap().path().is_dir())
            .count(),
        0
    );
}

#[test]
fn a_stopped_run_says_so_and_goes_on_later() {
    let space = Space::new();
    let child = space.spawn(&SLOW);
    wait_until("a stage", || {
        in_work(&space, ".srnerf", "scratch").is_some()
    });
    signal(&child, "-TERM");
    let said = Space::wait(child);
    assert_eq!(said.code, 75, "{}", said.err);
    assert!(
        said.err
            .contains("interrupted; the same command goes on where this one stopped"),
        "{}",
        said.err
    );
    space.ok(&SLOW);
}

/// The store's file behind a result that people see.
fn blobs(space: &Space, shown: &str) -> PathBuf {
    let bytes = fs::read(space.path(shown)).unwrap();
    let of_bytes = |path: &PathBuf| fs::read(path).is_ok_and(|found| found == bytes);
    let cas = space
        .files(".srnerf/cas")
        .into_keys()
        .map(|path| space.path(".srnerf/cas").join(path));
    cas.into_iter().find(of_bytes).unwrap()
}

/// Something that happens to a blob.
type Act = fn(&Path);

#[test]
fn a_lost_or_changed_blob_is_noticed_and_only_its_stage_runs_again() {
    let acts: [(&str, Act); 3] = [
        ("blob missing", |blob| fs::remove_file(blob).unwrap()),
        ("blob damaged", |blob| {
            fs::remove_file(blob).unwrap();
            fs::write(blob, "cut").unwrap();
        }),
        ("blob damaged", |blob| {
            let mut bytes = fs::read(blob).unwrap();
            *bytes.last_mut().unwrap() ^= 1;
            fs::remove_file(blob).unwrap();
            fs::write(blob, bytes).unwrap();
        }),
    ];
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let before = space.files("out");
    for (words, act) in acts {
        act(&blobs(&space, "out/tiny/up/images/view_001.exr"));
        let plan = space.ok(&["plan", "tiny.ron"]).out;
        assert!(
            plan.contains(&format!("{words}: images/view_001.exr")),
            "{plan}"
        );
        let run = space.ok(&["run", "tiny.ron", "--json"]);
        assert!(
            run.out
                .contains(&format!("{words}: images/view_001.exr; computing it again")),
            "{}",
            run.out
        );
        assert_eq!(
            (&run.last()["ran"], &run.last()["cached"]),
            (&json!(["up"]), &json!(["again", "scene"]))
        );
        space.assert_files("out", &before);
    }
}

#[test]
fn a_store_that_cannot_be_written_is_one_clear_error() {
    let space = Space::new();
    let said = space.say(&["run", "tiny.ron", "--store", "tiny.ron/store"]);
    assert_eq!(said.code, 4, "{}", said.err);
    assert!(said.err.contains("tiny.ron/store"), "{}", said.err);
    assert!(!space.path("out").exists());
}
