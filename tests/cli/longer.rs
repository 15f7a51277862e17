//! A run of more steps goes on from the finished result of fewer, where the steps allow it.

use serde_json::json;

use crate::checkpoint::{resumed, run, text, training};
use crate::files::assert_same_files;
use crate::space::Space;
use crate::whole::{SHORT, pipeline};

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
