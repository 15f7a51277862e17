//! Arms as users compare them: planned, run, scored, reported; one of them fails, one is added.

use std::fs;

use serde_json::{Value, json};

use crate::space::Space;
use crate::whole::pipeline;

const BASE: &str = r#"(
    name: "base",
    stages: {
        "scene": Scene(source: Procedural(views: 6, size: (64, 48), samples: 1), downscale: 4, holdout: 2),
        "fit": Fit(images: "scene.train", steps: 8, samples: 4096),
        "up": Interpolate(images: "scene.train", factor: 4),
        "sync": Sync(field: "fit", images: "up", low: "scene.train", steps: 4, samples: 4096),
        "evaluate": Evaluate(
            field: "sync", baseline: "fit", truth: "scene.test", low: "scene.test_low", train: "scene.train",
            supersample: 1,
        ),
    },
)"#;

const ARMS: &str = r#"(
    name: "arms",
    base: "base.ron",
    targets: ["evaluate"],
    arms: {
        "lr_nerf": { "evaluate.field": "fit" },
        "ours": {},
        "longer": { "sync.steps": 8 },
    },
    baseline: "lr_nerf",
    bound: "longer",
)"#;

fn arms(text: &str) -> Space {
    let space = Space::new();
    fs::write(space.path("base.ron"), BASE).unwrap();
    fs::write(space.path("arms.ron"), text).unwrap();
    space
}

fn ran(space: &Space, arguments: &[&str]) -> Value {
    space.ok(&[arguments, &["--json"]].concat()).last()["ran"].clone()
}

#[test]
fn arms_are_planned_run_and_compared() {
    let space = arms(ARMS);
    let plan = space.ok(&["plan", "arms.ron"]).out;
    assert!(plan.contains("lr_nerf/scene (and 2 more)"), "{plan}");
    assert!(
        plan.ends_with("3 arms, 13 stages, 8 unique, 0 cached\n"),
        "{plan}"
    );

    // An arm alone runs what it needs, under the names of the arms that it shares stages with.
    let alone = ran(&space, &["run", "arms.ron", "--arm", "lr_nerf"]);
    assert_eq!(
        alone,
        json!(["lr_nerf/evaluate", "lr_nerf/fit", "lr_nerf/scene"])
    );
    let plan = space.ok(&["plan", "arms.ron", "--arm", "lr_nerf"]).out;
    assert!(
        plan.ends_with("1 arm, 3 stages, 3 unique, 3 cached\n"),
        "{plan}"
    );
    let said = space.ok(&["run", "arms.ron"]);
    assert!(said.out.contains("minus lr_nerf"), "{}", said.out);
    assert!(said.err.contains("5 stages ran, 3 cached"), "{}", said.err);
    for arm in ["lr_nerf", "ours", "longer"] {
        assert!(
            space
                .path(&format!("out/arms/{arm}/evaluate/metrics/metrics.json"))
                .is_file(),
            "{arm}"
        );
    }
    let plan = space.ok(&["plan", "arms.ron"]).out;
    assert!(
        plan.ends_with("3 arms, 13 stages, 8 unique, 8 cached\n"),
        "{plan}"
    );

    // An arm that is added runs its own stages alone.
    fs::write(
        space.path("arms.ron"),
        ARMS.replace(
            "\"ours\": {},",
            "\"ours\": {}, \"sharp\": { \"up.filter\": Lanczos },",
        ),
    )
    .unwrap();
    let plan = space.ok(&["plan", "arms.ron"]).out;
    assert!(
        plan.ends_with("4 arms, 18 stages, 11 unique, 8 cached\n"),
        "{plan}"
    );
    assert_eq!(
        ran(&space, &["run", "arms.ron"]),
        json!(["sharp/evaluate", "sharp/sync", "sharp/up"])
    );

    let metrics = space.ok(&["metrics", "arms", "--json"]).json();
    let arms = metrics["arms"].as_array().unwrap();
    assert_eq!(arms.len(), 4);
    let ours = &arms[1];
    assert_eq!(ours["name"], "ours");
    assert_eq!(ours["scores"]["psnr_hr"]["difference"]["pairs"], 3);
    assert!(ours["cost"]["seconds"].as_f64().unwrap() > 0.0);
    let closed = |arm: &Value| arm["scores"]["psnr_hr"]["gap_closed"].as_f64().unwrap();
    assert!(closed(&arms[0]).abs() < 1e-9 && (closed(&arms[3]) - 1.0).abs() < 1e-9);
    let notes = metrics["notes"].to_string();
    assert!(notes.contains("no ssimulacra2_hr"), "{notes}");

    let table = space.ok(&["metrics", "arms", "--format", "md"]).out;
    assert!(table.contains("| arms | psnr_hr ↑ |"), "{table}");
    let table = space.ok(&["metrics", "arms", "--format", "latex"]).out;
    assert!(table.contains("lr\\_nerf & "), "{table}");
    let table = space.ok(&["metrics", "arms", "--format", "csv"]).out;
    assert!(table.starts_with("arm,metric,mean,spread,"), "{table}");
    let table = space.ok(&["metrics", "arms", "--diff-only"]).out;
    assert!(
        table.contains("up.filter") && table.contains("Lanczos"),
        "{table}"
    );

    space.ok(&["report", "arms.ron", "-o", "report.html"]);
    let page = fs::read_to_string(space.path("report.html")).unwrap();
    assert!(page.contains("is the best by psnr_hr"), "no verdict");
    assert!(
        !page.contains("http://") && !page.contains("https://"),
        "it needs no network"
    );
    assert!(
        page.contains("<text x=\"11\" y=\"18\">scene</text>"),
        "no graph"
    );
    assert!(page.contains("sharp: ran. Why: "), "{page}");
}

#[test]
fn seeds_share_the_photos_and_give_a_spread() {
    let space = arms(&ARMS.replace("baseline:", "seeds: [3, 4], baseline:"));
    let plan = space.ok(&["plan", "arms.ron"]).out;
    assert!(
        plan.ends_with("3 arms x 2 seeds, 26 stages, 15 unique, 0 cached\n"),
        "{plan}"
    );
    space.ok(&["run", "arms.ron"]);
    assert!(space.path("out/arms/ours/seed_4/sync").is_dir());
    let metrics = space.ok(&["metrics", "--json"]).json();
    let spread = &metrics["arms"][1]["scores"]["psnr_hr"]["spread"];
    assert!(spread.as_f64().unwrap() > 0.0, "{spread}");
}

/// The low-resolution photos of other views: that they do not fit shows only when the stage runs.
fn one_fails() -> Space {
    arms(&ARMS.replace(
        "\"ours\": {},",
        "\"ours\": { \"evaluate.low\": \"scene.train\" },",
    ))
}

#[test]
fn an_arm_that_fails_is_named_and_the_others_go_on() {
    let space = one_fails();
    let said = space.say(&["run", "arms.ron"]);
    assert_eq!(said.code, 1, "{}", said.err);
    assert!(said.err.contains("(the arm ours fails)"), "{}", said.err);
    assert!(
        said.err.contains("arm ours: ours/evaluate: "),
        "{}",
        said.err
    );
    assert!(
        said.out.contains("ours: its stage evaluate failed"),
        "{}",
        said.out
    );
    assert!(space.path("out/arms/longer/evaluate").is_dir());
}

#[test]
fn a_run_that_fails_fast_begins_nothing_more() {
    let space = one_fails();
    let said = space.say(&["run", "arms.ron", "--fail-fast", "--threads", "1"]);
    assert_eq!(said.code, 1, "{}", said.err);
    assert!(!space.path("out/arms/longer/evaluate").exists());
}

#[test]
fn mistakes_name_the_arm_and_the_place() {
    let space = arms(ARMS);
    let said = space.say(&["run", "arms.ron", "--arm", "our"]);
    assert_eq!(said.code, 2);
    assert!(said.err.contains("no arm `our`"), "{}", said.err);
    let said = space.say(&["metrics", "--diff-only"]);
    assert_eq!(said.code, 2);
    fs::write(space.path("arms.ron"), ARMS.replace("base.ron", "bass.ron")).unwrap();
    let said = space.say(&["plan", "arms.ron"]);
    assert_eq!(said.code, 3);
    assert!(said.err.contains("bass.ron"), "{}", said.err);
}

#[test]
fn exports_have_a_job_for_each_stage_that_arms_do_not_share() {
    let space = arms(ARMS);
    space.ok(&["export", "snakemake", "arms.ron"]);
    let text = fs::read_to_string(space.path("Snakefile")).unwrap();
    assert_eq!(text.matches("\nrule ").count(), 1 + 8);
    assert!(text.contains("rule longer_sync:"), "{text}");
    assert!(text.contains("--only longer/sync "), "{text}");
    space.ok(&["export", "slurm", "arms.ron", "--arm", "ours"]);
    let script = fs::read_to_string(space.path("slurm/ours/sync.sh")).unwrap();
    assert!(
        script.contains("#SBATCH --job-name=ours-sync\n"),
        "{script}"
    );
    assert!(script.contains("--arm ours"), "{script}");
    assert!(!space.path("slurm/longer").exists());
}

/// What stages there are, with the manifest of each, so far as it is known before anything ran.
#[test]
fn pipelines_that_extend_the_main_job_have_its_stages() {
    let space = Space::new();
    let said = space.ok(&["diff", &pipeline("i3ds"), &pipeline("orbit"), "--json"]);
    let stages = said.json()["stages"].clone();
    let differ: Vec<&Value> = stages
        .as_array()
        .unwrap()
        .iter()
        .filter(|stage| stage["state"] != "same")
        .collect();
    let names: Vec<&str> = differ
        .iter()
        .filter_map(|stage| stage["stage"].as_str())
        .collect();
    assert_eq!(names, ["film", "fly"], "{differ:?}");
}
