//! `--device`: what there is, what there is not, and what is computed where.

use std::fs;

use crate::model::{ask, inputs, save};
use crate::space::{Space, assert_same_files};

/// Whether there is an adapter to test; said aloud if not, and a failure where the tests must not
/// do without.
fn is_there(space: &Space) -> bool {
    let said = space.ok(&["--json", "doctor"]);
    let found = said.json()["adapters"]
        .as_array()
        .is_some_and(|adapters| !adapters.is_empty());
    if !found {
        assert!(
            std::env::var_os("SRNERF_REQUIRE_GPU").is_none(),
            "there is no GPU: {}",
            said.out
        );
        eprintln!("skipped, there is no GPU to test: {}", said.out);
    }
    found
}

#[test]
fn the_doctor_lists_adapters_with_a_self_test() {
    let space = Space::new();
    if !is_there(&space) {
        return;
    }
    let report = &space.ok(&["--json", "doctor"]).json()["adapters"][0];
    assert_eq!(
        (&report["device"], &report["self_test"]["passed"]),
        (&"gpu:0".into(), &true.into()),
        "{report:#}"
    );
    assert!(
        report["limits"]["bytes of one array that a kernel sees"].as_u64() >= Some(1 << 27),
        "{report:#}"
    );
    let text = space.ok(&["doctor"]).out;
    assert!(
        text.contains("self-test passed") && text.contains("\nauto     "),
        "{text}"
    );
}

#[test]
fn without_a_loader_the_program_computes_on_the_cpu_and_the_doctor_says_what_is_missing() {
    let space = Space::new();
    // A loader that is none hides the system's.
    ["libvulkan.so.1", "libvulkan.so"]
        .iter()
        .for_each(|name| fs::write(space.path(name), "no library").unwrap());
    let hidden = [(
        "LD_LIBRARY_PATH",
        space.path("").to_str().unwrap().to_owned(),
    )];
    let doctor = space.say_with(&hidden, &["doctor"]);
    assert_eq!(doctor.code, 0, "{}", doctor.err);
    assert!(
        doctor.out.contains("auto     the CPU: no GPU was found"),
        "{}",
        doctor.out
    );
    assert!(
        doctor.out.contains("the Vulkan loader cannot be loaded"),
        "{}",
        doctor.out
    );
    let asked = space.say_with(&hidden, &["run", "tiny.ron", "--device", "gpu"]);
    assert!(
        asked.code == 2 && asked.err.contains("no GPU was found"),
        "{}",
        asked.err
    );
    let run = space.say_with(&hidden, &["run", "tiny.ron"]);
    assert_eq!(run.code, 0, "{}", run.err);
}

#[test]
fn a_device_that_is_not_there_is_named() {
    let space = Space::new();
    for (name, problem) in [
        ("gpu:99", "no GPU"),
        ("gpu:x", "there is no device `gpu:x`"),
        ("tpu", "there is no device `tpu`"),
    ] {
        let said = space.say(&["plan", "tiny.ron", "--device", name]);
        assert!(
            said.code == 2 && said.err.contains(problem),
            "{name}: {}",
            said.err
        );
    }
}

#[test]
fn a_network_gives_nearly_the_same_on_a_gpu_the_same_in_each_run_and_counts_what_it_does() {
    let space = Space::new();
    if !is_there(&space) {
        return;
    }
    save(&space.path("in.safetensors"), &inputs());
    let runs = [("cpu", "cpu"), ("gpu:0", "one"), ("gpu:0", "two")];
    let said = runs.map(|(device, output)| {
        ask(
            &space,
            output,
            &["--json", "--target-grad", "--device", device],
        )
    });
    said.iter()
        .for_each(|said| assert_eq!(said.code, 0, "{}", said.err));
    assert_eq!(
        fs::read(space.path("one")).unwrap(),
        fs::read(space.path("two")).unwrap()
    );
    let [here, there] = ["cpu", "one"].map(|name| fs::read(space.path(name)).unwrap());
    let [here, there] =
        [&here, &there].map(|bytes| safetensors::SafeTensors::deserialize(bytes).unwrap());
    for (name, expected) in here.tensors() {
        let numbers = |bytes: &[u8]| {
            bytes
                .as_chunks()
                .0
                .iter()
                .map(|b| f64::from(f32::from_le_bytes(*b)))
                .collect()
        };
        let expected: Vec<f64> = numbers(expected.data());
        let got: Vec<f64> = numbers(there.tensor(&name).unwrap().data());
        let norm =
            |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
        let off = norm(&mut expected.iter().zip(&got).map(|(a, b)| a - b))
            / norm(&mut expected.iter().copied());
        assert!(off < 1e-4, "{name} is off by {off:.1e}");
    }
    assert_eq!(said[0].json()["device"], "cpu");
    assert!(
        said[0].json()["counts"].is_null()
            && said[1].json()["counts"]["dispatches"].as_u64() > Some(100)
    );
    assert!(
        said[1].json()["device"]
            .as_str()
            .unwrap()
            .starts_with("gpu: "),
        "{}",
        said[1].out
    );
    let refused = ask(
        &space,
        "three",
        &["--precision", "bf16", "--device", "gpu:0"],
    );
    assert!(
        refused.code == 2 && refused.err.contains("a GPU multiplies in f32 only"),
        "{}",
        refused.err
    );
}

/// Every stage that computes on a GPU but those of the diffusion networks.
const FIELDS: &str = r#"(
    name: "fields",
    stages: {
        "scene": Scene(source: Procedural(world: "still_life", views: 4, size: (64, 48)), downscale: 4, holdout: 4),
        "fit": Fit(images: "scene.train", steps: 20, samples: 256, supersample: 1, field: (levels: 4, march_steps: 32)),
        "render": Render(field: "fit", cameras: "scene.train", scale: 2),
        "sync": Sync(field: "fit", images: "render", low: "scene.train", steps: 4, samples: 256),
    },
)"#;

#[test]
fn the_stages_of_a_field_give_the_same_files_in_each_run_and_say_where_they_ran() {
    let space = Space::new();
    if !is_there(&space) {
        return;
    }
    fs::write(space.path("fields.ron"), FIELDS).unwrap();
    // A checkpoint after every step, and none.
    for (out, every) in [("one", "0"), ("two", "1h")] {
        let store = format!("{out}.store");
        let options = [
            "--device",
            "gpu:0",
            "--store",
            &store,
            "--out",
            out,
            "--checkpoint-every",
            every,
        ];
        let said = space.ok(&[&["run", "fields.ron"], &options[..]].concat());
        assert!(
            said.err.contains("fit: dispatches per step 10."),
            "{}",
            said.err
        );
    }
    assert_same_files(&space, "one", "two");
    let options = [
        "--device",
        "gpu:0",
        "--store",
        "one.store",
        "--fallback",
        "cpu",
    ];
    let plan = space
        .ok(&[&["plan", "fields.ron"], &options[..]].concat())
        .out;
    assert!(
        plan.contains("4 stages: 4 cached, 0 to run"),
        "a fallback that was not needed changes no key: {plan}"
    );
    let field = fs::read(space.path("one/fields/sync/field/field.safetensors")).unwrap();
    assert!(
        String::from_utf8_lossy(&field).contains("gpu: "),
        "the field does not say where it was computed"
    );
}

#[test]
#[ignore = "make test-full"]
fn every_stage_runs_with_a_gpu_and_two_runs_give_the_same_files() {
    let space = Space::new();
    if !is_there(&space) {
        return;
    }
    fs::write(space.path("golden.ron"), include_str!("golden.ron")).unwrap();
    for out in ["one", "two"] {
        let store = format!("{out}.store");
        let said = space.ok(&[
            "run",
            "golden.ron",
            "--device",
            "gpu:0",
            "--store",
            &store,
            "--out",
            out,
        ]);
        assert!(
            said.err.contains("all other stages run on the CPU"),
            "{}",
            said.err
        );
    }
    assert_same_files(&space, "one", "two");
    let latents = fs::read(space.path("one/golden/encode/latents/latents.safetensors")).unwrap();
    assert!(
        String::from_utf8_lossy(&latents).contains("gpu: "),
        "the latents do not say where they were computed"
    );
}
