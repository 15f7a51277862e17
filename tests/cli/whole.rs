//! The whole method, every stage real, at settings that take seconds.

use serde_json::{Value, json};

use crate::files::assert_same_files;
use crate::space::Space;

/// `smoke.ron` with one round and the fewest of everything.
pub const SHORT: &[&str] = &[
    "--set=scene.source=Procedural(views: 4, size: (64, 48))",
    "--set=scene.holdout=4",
    "--set=fit.steps=20",
    "--set=i3ds.count=1",
    "--set=i3ds.optimize.steps=4",
    "--set=i3ds.optimize.guidance.warm_up=1",
    "--set=i3ds.sync.steps=10",
];

pub fn pipeline(name: &str) -> String {
    format!("{}/pipelines/{name}.ron", env!("CARGO_MANIFEST_DIR"))
}

/// The command line of a short run, with more behind it.
fn short<'a>(command: &'a [&'a str], more: &[&'a str]) -> Vec<&'a str> {
    [command, SHORT, more].concat()
}

/// What the last event of a run says it ran.
fn ran(space: &Space, arguments: &[&str]) -> Value {
    space.ok(&[arguments, &["--json"]].concat()).last()["ran"].clone()
}

#[test]
fn every_pipeline_that_ships_can_be_planned() {
    let space = Space::new();
    for name in ["i3ds", "orbit", "smoke", "paper", "disr", "repo"] {
        let plan = space.ok(&["plan", &pipeline(name)]);
        assert!(plan.out.contains("i3ds.1.optimize"), "{name}: {}", plan.out);
    }
    let plan = space.ok(&["plan", &pipeline("ablation")]);
    assert!(plan.out.contains("17 arms, "), "{}", plan.out);
    let plan = space.ok(&["plan", &pipeline("object")]);
    assert!(plan.out.contains("evaluate"), "{}", plan.out);
}

/// Before white, where its photos are transparent, an object's field is as good after
/// synchronization as before it.
#[test]
fn a_transparent_scene_stays_transparent() {
    let space = Space::new();
    let smoke = pipeline("smoke");
    let settings = [
        "--set=scene.source=Procedural(world: \"object\", views: 6, size: (64, 64), samples: 1)",
        "--set=fit.steps=150",
        "--set=i3ds.sync.steps=60",
        "--set=i3ds.sync.rate=0.002",
    ];
    space.ok(&[&short(&["run", &smoke], &[])[..], &settings].concat());
    let metrics: Value = serde_json::from_slice(
        &space
            .files("out")
            .into_iter()
            .find(|(path, _)| path.ends_with("metrics.json"))
            .unwrap()
            .1,
    )
    .unwrap();
    let psnr = |row: &str| metrics["rows"][row]["mean"]["psnr_hr"].as_f64().unwrap();
    assert!(
        psnr("sr_nerf") > psnr("lr_nerf") - 1.0,
        "{} {}",
        psnr("sr_nerf"),
        psnr("lr_nerf")
    );
    assert!(psnr("lr_nerf") > 12.0, "{}", psnr("lr_nerf"));
}

#[test]
fn the_method_runs_from_photos_to_metrics() {
    let space = Space::new();
    let smoke = pipeline("smoke");
    let run = ["run", smoke.as_str()];
    assert_eq!(ran(&space, &short(&run, &[])).as_array().unwrap().len(), 11);
    let metrics: Value = serde_json::from_slice(
        &space
            .files("out")
            .into_iter()
            .find(|(path, _)| path.ends_with("metrics.json"))
            .unwrap()
            .1,
    )
    .unwrap();
    for row in ["bicubic", "lr_nerf", "sr_nerf"] {
        let psnr = metrics["rows"][row]["mean"]["psnr_hr"].as_f64().unwrap();
        assert!((5.0..40.0).contains(&psnr), "{row}: {psnr} dB");
    }
    let table = space.ok(&["metrics"]).out;
    let columns: Vec<&str> = table.lines().next().unwrap().split_whitespace().collect();
    assert_eq!(columns[..3], ["evaluate", "psnr_hr", "ssim_hr"]);
    assert_eq!(ran(&space, &short(&run, &[])), json!([]));
    let after = [
        "evaluate",
        "i3ds.1.decode",
        "i3ds.1.optimize",
        "i3ds.1.sync",
    ];
    assert_eq!(
        ran(
            &space,
            &short(&run, &["--set=i3ds.optimize.guidance.lora_every=1"])
        ),
        json!(after)
    );
}

#[test]
fn views_refined_in_shards_have_a_lora_for_each_shard() {
    let space = Space::new();
    let smoke = pipeline("smoke");
    let shards = ["--set=i3ds.render.shards=2", "--set=i3ds.optimize.shards=2"];
    space.ok(&short(&["run", smoke.as_str()], &shards));
    let files = |stage: &str| {
        space
            .files(&format!("out/smoke/i3ds.1.{stage}"))
            .into_keys()
            .collect::<Vec<_>>()
    };
    assert!(
        files("optimize.2/lora")
            .iter()
            .any(|file| file.ends_with("pytorch_lora_weights.safetensors"))
    );
    assert!(files("optimize/lora").is_empty() && !files("optimize/residuals").is_empty());
    let decoded = files("decode/images");
    assert_eq!(
        decoded
            .iter()
            .filter(|file| file.extension().is_some_and(|end| end == "exr"))
            .count(),
        3
    );
}

#[test]
fn the_method_gives_the_same_bytes_for_any_number_of_threads() {
    let space = Space::new();
    let smoke = pipeline("smoke");
    for threads in ["1", "3"] {
        let store = format!("--store=s{threads}");
        let out = format!("--out=o{threads}");
        space.ok(&short(
            &["run", smoke.as_str()],
            &["--threads", threads, &store, &out],
        ));
    }
    assert_same_files(&space, "o1", "o3");
}

#[test]
fn a_real_llff_scene_takes_the_place_of_the_drawn_one() {
    let Some(data) = std::env::var_os("SRNERF_TEST_DATA") else {
        eprintln!("SRNERF_TEST_DATA is not set: no real scene was tried");
        return;
    };
    let fern = std::path::Path::new(&data).join("llff/fern");
    let scene = format!(
        "--set=scene.source=Llff(path: {:?}, size: (84, 63))",
        fern.to_string_lossy()
    );
    let space = Space::new();
    let smoke = pipeline("smoke");
    let said = space.ok(&short(
        &["run", smoke.as_str()],
        &[scene.as_str(), "--set=scene.holdout=8"],
    ));
    assert!(said.out.contains("sr_nerf"), "{}", said.out);
}
