//! The whole method killed at random moments, and continued each time, ends with the digests of a
//! run that was left alone.

use std::collections::BTreeSet;
use std::fs;

use serde_json::Value;

use crate::cut::cut_after;
use crate::space::Space;
use crate::whole::{SHORT, pipeline};

/// The most files that a run has written when it is killed: much of a run, so that some runs end.
const MOST: u64 = 200;

/// Numbers that look random (Marsaglia 2003, xorshift).
struct Dice(u64);

impl Dice {
    fn below(&mut self, end: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % end
    }
}

/// What stages gave: their names, outputs and semantic digests. Every blob must be what its name
/// says.
fn digests(space: &Space, store: &str) -> BTreeSet<String> {
    let mut digests = BTreeSet::new();
    for bytes in space.files(&format!("{store}/results")).into_values() {
        let record: Value = serde_json::from_slice(&bytes).unwrap();
        for (name, output) in record["outputs"].as_object().unwrap() {
            digests.insert(format!("{} {name} {}", record["stage"], output["digest"]));
            for file in output["files"].as_array().unwrap() {
                let blob = file["blob"].as_str().unwrap();
                let bytes =
                    fs::read(space.path(store).join("cas").join(&blob[..2]).join(blob)).unwrap();
                assert_eq!(
                    blake3::hash(&bytes).to_string(),
                    blob,
                    "{} {file}",
                    record["stage"]
                );
            }
        }
    }
    digests
}

/// The same kills in every run of the tests; `SRNERF_SOAK_SEED` chooses others.
const SEED: u64 = 20_261_129;

/// The command line of a run into `wild`; each life has keys of its own.
fn life(number: u64) -> Vec<String> {
    let salt = format!("--salt=life {number}");
    let own = [
        "run",
        &pipeline("smoke"),
        "--store=wild",
        "--out=wild-out",
        "--checkpoint-every=0",
        &salt,
    ];
    own.iter().chain(SHORT).map(ToString::to_string).collect()
}

fn soak(kills: usize) {
    let given = std::env::var("SRNERF_SOAK_SEED").ok();
    let seed = given
        .and_then(|seed| seed.parse().ok())
        .unwrap_or(SEED)
        .max(1);
    // Shown only if the test fails.
    println!("to try the same again: SRNERF_SOAK_SEED={seed}");
    let space = Space::new();
    let mut dice = Dice(seed);
    let mut number = 0;
    let mut killed = 0;
    let calm: Vec<String> = life(0)
        .iter()
        .map(|argument| argument.replace("wild", "calm"))
        .collect();
    space.ok(&calm.iter().map(String::as_str).collect::<Vec<_>>());
    let calm = digests(&space, "calm");
    while killed < kills {
        let files = dice.below(MOST) as usize;
        let name = ["-KILL", "-TERM"][dice.below(2) as usize];
        let arguments = life(number);
        let arguments: Vec<_> = arguments.iter().map(String::as_str).collect();
        let said = cut_after(files, name, "wild", &space, &arguments);
        assert!(
            [-1, 75, 143, 0].contains(&said.code),
            "{} after {files} files: {}",
            said.code,
            said.err
        );
        number += u64::from(said.code == 0);
        killed += usize::from(said.code != 0);
        assert!(
            digests(&space, "wild").is_subset(&calm),
            "after {files} files and {name}"
        );
        let checked = space.say(&["store", "fsck", "--store=wild", "--out=wild-out"]);
        assert_eq!(
            checked.code, 0,
            "after {files} files and {name}: {}{}",
            checked.out, checked.err
        );
    }
    space.ok(&life(number).iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(digests(&space, "wild"), calm);
}

#[test]
fn killed_a_few_times_the_method_ends_as_if_undisturbed() {
    soak(6);
}

#[test]
#[ignore = "make test-full"]
fn killed_a_hundred_times_the_method_ends_as_if_undisturbed() {
    soak(100);
}
