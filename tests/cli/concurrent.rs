//! Several processes on one pipeline and one store: they split the work, and none computes what
//! another has.

use std::collections::BTreeMap;
use std::fs;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::checkpoint::{TRAINING, checkpoint, resumed};
use crate::space::{Space, signal};
use crate::whole::{SHORT, pipeline};

/// How often each stage was computed, by the records of all runs.
fn computed(space: &Space) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for bytes in space.files(".srnerf/runs").into_values() {
        let run: Value = serde_json::from_slice(&bytes).unwrap();
        for (stage, of) in run["stages"].as_object().unwrap() {
            *counts.entry(stage.clone()).or_default() += usize::from(of["end"] == "ran");
        }
    }
    counts
}

#[test]
fn processes_on_one_store_compute_each_key_once() {
    for processes in [2, 4] {
        let space = Space::new();
        let smoke = pipeline("smoke");
        let arguments = [&["run", smoke.as_str(), "--json"][..], SHORT].concat();
        let children: Vec<_> = (0..processes).map(|_| space.spawn(&arguments)).collect();
        for said in children.into_iter().map(Space::wait) {
            assert_eq!(said.code, 0, "{}{}", said.out, said.err);
        }
        let computed = computed(&space);
        assert_eq!(computed.len(), 11);
        assert!(
            computed.values().all(|&times| times == 1),
            "{processes} processes: {computed:?}"
        );
        assert_eq!(
            fs::read_dir(space.path(".srnerf/leases")).unwrap().count(),
            0
        );
    }
}

/// A command on a host of its own, as far as it can tell: with another name, and numbers of
/// processes that say nothing elsewhere. `None` where the system lets nobody pretend that.
fn on_host(space: &Space, name: &str, arguments: &[&str]) -> Option<Child> {
    let apart = [
        "--user",
        "--map-root-user",
        "--uts",
        "--pid",
        "--fork",
        "--mount-proc",
    ];
    let unshare = || {
        let mut command = Command::new("unshare");
        command
            .args(apart)
            .current_dir(space.path("."))
            .stdin(Stdio::null());
        command
    };
    let can = unshare()
        .args(["hostname", name])
        .output()
        .is_ok_and(|output| output.status.success());
    let said = || fs::File::create(space.path(name)).unwrap();
    let script = "hostname \"$0\" && exec \"$@\"";
    let program = env!("CARGO_BIN_EXE_srnerf-dag");
    can.then(|| {
        unshare()
            .args(["sh", "-c", script, name, program])
            .args(arguments)
            .stdout(said())
            .spawn()
            .unwrap()
    })
}

#[test]
fn hosts_on_one_folder_compute_each_key_once() {
    let space = Space::new();
    fs::write(space.path("training.ron"), TRAINING).unwrap();
    let run = ["run", "training.ron", "--json", "--checkpoint-every=0"];
    let Some(north) = on_host(&space, "north", &run) else {
        eprintln!("not tested: this system has no `unshare` for this user");
        return;
    };
    checkpoint(&space, ".srnerf");
    let south = on_host(&space, "south", &run).unwrap();
    for child in [north, south] {
        assert_eq!(Space::wait(child).code, 0);
    }
    let waited = fs::read_to_string(space.path("south")).unwrap();
    assert!(
        waited.contains("\"event\":\"waiting\"") && waited.contains("\"host\":\"north\""),
        "{waited}"
    );
    assert!(
        computed(&space).values().all(|&times| times == 1),
        "{:?}",
        computed(&space)
    );
    assert_eq!(
        fs::read_dir(space.path(".srnerf/leases")).unwrap().count(),
        0
    );
}

#[test]
fn the_work_of_a_process_that_is_killed_is_taken_over() {
    let space = Space::new();
    fs::write(space.path("training.ron"), TRAINING).unwrap();
    let run = ["run", "training.ron", "--json", "--checkpoint-every=0"];
    let first = space.spawn(&run);
    checkpoint(&space, ".srnerf");
    signal(&first, "-STOP");
    let second = space
        .command(&run)
        .stdout(fs::File::create(space.path("said")).unwrap())
        .spawn()
        .unwrap();
    let waiting = |said: &str| {
        said.contains("\"event\":\"waiting\"") && said.contains(&format!("{}", first.id()))
    };
    let begun = Instant::now();
    while !waiting(&fs::read_to_string(space.path("said")).unwrap()) {
        assert!(
            begun.elapsed() < Duration::from_secs(60),
            "the second process waits for nobody"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    signal(&first, "-KILL");
    Space::wait(first);
    let mut second = Space::wait(second);
    second.out = fs::read_to_string(space.path("said")).unwrap();
    assert_eq!(second.code, 0, "{}", second.err);
    assert_eq!(resumed(&second)[0].0, "fit", "{}", second.out);
    assert!(computed(&space).values().all(|&times| times <= 1));
}
