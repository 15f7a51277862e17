//! Upsamplers: checked and asked by `model`, and as a filter of `Interpolate`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::json;

use crate::space::{Said, Space};
use crate::tensors::{Tensor, save};
use crate::whole::pipeline;

/// A file of the upsampler's crate.
fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("stages/upsampler")
        .join(name)
}

fn image(shape: &[usize]) -> Tensor {
    let value = |i: usize| (i * 7919 % 1000) as f32 / 1000.0;
    (
        "F32",
        shape.to_vec(),
        (0..shape.iter().product())
            .flat_map(|i| value(i).to_le_bytes())
            .collect(),
    )
}

/// Asks an upsampler about an image of this shape.
fn ask(space: &Space, model: &str, shape: &[usize], output: &str, more: &[&str]) -> Said {
    save(
        &space.path("in.safetensors"),
        &BTreeMap::from([("sample", image(shape))]),
    );
    let files = ["--input", "in.safetensors", "--output", output];
    space.say(
        &[
            &["model", "run", model, "--part", "upsample"],
            &files[..],
            more,
        ]
        .concat(),
    )
}

#[test]
fn an_upsampler_is_checked() {
    let space = Space::new();
    let said = space
        .ok(&["model", "check", "embedded", "--part", "upsample", "--json"])
        .json();
    let part = &said["parts"][0];
    assert_eq!(
        (&part["family"], &part["scale"]),
        (&json!("Residual"), &json!(4))
    );
    assert_eq!(said["digest"].as_str().unwrap().len(), 64);
    let bin = file("tests/golden/ncnn-span-f16.bin");
    let said = space
        .ok(&[
            "model",
            "check",
            bin.to_str().unwrap(),
            "--part",
            "upsample",
            "--json",
        ])
        .json();
    assert_eq!(
        (
            &said["parts"][0]["width"],
            said["files"].as_array().unwrap().len()
        ),
        (&json!(48), 2)
    );
    let words = space
        .ok(&["model", "check", "embedded", "--part", "upsample"])
        .out;
    assert!(
        words.contains("Residual") && words.contains("x4") && words.contains("sha256"),
        "{words}"
    );
    // What is embedded is a model like any other.
    let parts = space.ok(&["model", "check", "embedded", "--json"]).json()["parts"]
        .as_array()
        .unwrap()
        .len();
    assert_eq!(parts, 3);
}

#[test]
fn an_upsampler_gives_the_same_bytes_for_any_number_of_threads() {
    let space = Space::new();
    for (output, threads) in [("a", "1"), ("b", "2")] {
        let said = ask(
            &space,
            "embedded",
            &[1, 3, 20, 150],
            output,
            &["--threads", threads, "--tile", "128"],
        );
        assert_eq!((said.code, &said.out[..]), (0, ""), "{}", said.err);
    }
    assert!(fs::read(space.path("a")).unwrap() == fs::read(space.path("b")).unwrap());
    let said = ask(
        &space,
        "embedded",
        &[2, 3, 4, 5],
        "c",
        &["--ensemble", "--repeat", "1", "--json"],
    );
    assert_eq!(
        said.json()["tensors"],
        json!({"sample": [2, 3, 16, 20]}),
        "{}",
        said.err
    );
}

#[test]
fn what_an_upsampler_cannot_be_asked_is_named_and_nothing_is_written() {
    let space = Space::new();
    let refused = |model: &str, shape: &[usize], more: &[&str], code: i32, words: &str| {
        let said = ask(&space, model, shape, "out", more);
        assert_eq!(said.code, code, "{}", said.err);
        let text = said.err.replace("\n  │ ", " ").replace('\n', " ");
        assert!(text.contains(words), "{}", said.err);
        assert!(!space.path("out").exists());
    };
    refused(
        "embedded",
        &[1, 4, 5, 5],
        &[],
        3,
        "tensor `sample` has the shape [1, 4, 5, 5]; expected [*, 3, *, *]",
    );
    refused("embedded", &[3, 5, 5], &[], 3, "expected [*, 3, *, *]");
    refused(
        "embedded",
        &[1, 3, 5, 5],
        &["--target-grad"],
        2,
        "an upsampler has no LoRA and no gradients",
    );
    refused(
        "nothing.safetensors",
        &[1, 3, 5, 5],
        &[],
        3,
        "nothing.safetensors: is missing",
    );
    refused("net.pth", &[1, 3, 5, 5], &[], 3, "net.pth: is a pickle");
}

/// Photos of 16x12 enlarged by a network.
const ENLARGE: &str = r#"(
    name: "enlarge",
    stages: {
        "scene": Scene(source: Procedural(world: "still_life", views: 2, size: (64, 48), samples: 1), downscale: 4, holdout: 2),
        "enlarge": Interpolate(images: "scene.train", factor: FACTOR, filter: Learned(OPTIONS)),
    },
)"#;

fn enlarge(space: &Space, factor: &str, options: &str) {
    fs::write(
        space.path("enlarge.ron"),
        ENLARGE
            .replace("FACTOR", factor)
            .replace("OPTIONS", options),
    )
    .unwrap();
}

#[test]
fn a_network_is_a_filter_of_interpolate() {
    let space = Space::new();
    for (factor, side) in [("4", 64), ("2", 32), ("5", 80)] {
        enlarge(&space, factor, "");
        space.ok(&["run", "enlarge.ron"]);
        let files = space.files("out/enlarge/enlarge").into_keys();
        let images: Vec<PathBuf> = files
            .filter(|path| path.extension().is_some_and(|end| end == "exr"))
            .collect();
        assert!(!images.is_empty());
        for image in images {
            let image = space.path("out/enlarge/enlarge").join(image);
            let size = exr::meta::MetaData::read_from_file(image, false)
                .unwrap()
                .headers[0]
                .layer_size;
            assert_eq!((size.0, size.1), (side, side * 3 / 4));
        }
    }
    enlarge(&space, "4", "ensemble: true, tile: 128");
    space.ok(&["run", "enlarge.ron", "--set=enlarge.back_projection=2"]);
}

#[test]
fn its_weights_belong_to_the_key_and_their_place_does_not() {
    let space = Space::new();
    enlarge(&space, "4", "");
    space.ok(&["run", "enlarge.ron"]);
    let explained = space.ok(&["explain", "enlarge", "enlarge.ron"]).out;
    assert!(
        explained.contains("sources.model") && !explained.contains("filter.model"),
        "{explained}"
    );
    let set = |file: &str| format!("--set=enlarge.filter=Learned(model: File(\"{file}\"))");
    let ran = |set: &str| space.ok(&["run", "enlarge.ron", set, "--json"]).last()["ran"].clone();
    // The same weights elsewhere.
    fs::copy(
        file("models/residual-x4.safetensors"),
        space.path("copy.safetensors"),
    )
    .unwrap();
    assert_eq!(ran(&set("copy.safetensors")), json!([]));
    for ending in ["param", "bin"] {
        fs::copy(
            file(&format!("tests/golden/ncnn-span-f16.{ending}")),
            space.path(&format!("x.{ending}")),
        )
        .unwrap();
    }
    assert_eq!(ran(&set("x.param")), json!(["enlarge"]));
    assert_eq!(ran(&set("x.bin")), json!([]));
    assert_eq!(
        ran("--set=enlarge.filter.model=File(\"x.param\")"),
        json!([])
    );
    let mut weights = fs::read(space.path("x.bin")).unwrap();
    weights[40] ^= 1;
    fs::write(space.path("x.bin"), weights).unwrap();
    assert_eq!(
        ran(&set("x.param")),
        json!(["enlarge"]),
        "one bit of the weights"
    );
}

#[test]
fn a_filter_that_makes_no_sense_is_refused_before_anything_runs() {
    let space = Space::new();
    enlarge(&space, "4", "");
    let refused = |set: &str, words: &str| {
        let said = space.say(&["plan", "enlarge.ron", &format!("--set={set}")]);
        assert!(said.code == 2 || said.code == 3, "{}", said.err);
        let text = said.err.replace("\n  │ ", " ").replace('\n', " ");
        assert!(text.contains(words), "{}", said.err);
    };
    refused(
        "enlarge.filter.tile=100",
        "`filter.tile` is 100; it must be at least 128",
    );
    refused(
        "enlarge.values=Linear",
        "`values` is Linear; a learned filter takes Srgb",
    );
    refused(
        "enlarge.back_projection=1001",
        "`back_projection` is 1001; it must be at most 1000",
    );
    refused(
        "enlarge.filter.model=File(\"x.pth\")",
        "stage `enlarge`: x.pth: is a pickle",
    );
    refused(
        "enlarge.filter.model=File(\"x.safetensors\")",
        "x.safetensors: is missing",
    );
    fs::write(space.path("text.safetensors"), "no network").unwrap();
    refused(
        "enlarge.filter.model=File(\"text.safetensors\")",
        "text.safetensors: is not a sound safetensors file",
    );
}

#[test]
fn a_network_to_measure_with_is_looked_at_before_anything_runs() {
    let space = Space::new();
    fs::write(space.path("text.safetensors"), "no network").unwrap();
    let said = space.say(&[
        "run",
        &pipeline("smoke"),
        "--set=evaluate.lpips=[\"text.safetensors\"]",
    ]);
    assert_eq!(said.code, 3, "{}", said.err);
    assert!(
        said.err
            .contains("text.safetensors: is not a sound safetensors file"),
        "{}",
        said.err
    );
    assert!(!space.path("out").exists(), "nothing ran");
}
