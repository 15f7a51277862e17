//! `export kohya`: what a run has learnt, in the layout of other programs, does there what it does here.

use std::fs;

use crate::model_run::{ask, inputs};
use crate::space::Space;
use crate::tensors::save;

/// One round of guidance on three small views, in which the LoRA learns.
const LEARNT: &str = r#"(
    name: "learnt",
    stages: {
        "scene": Scene(source: Procedural(views: 4, size: (48, 36), samples: 1), downscale: 4, holdout: 4),
        "enlarge": Interpolate(images: "scene.train", factor: 4),
        "encode": Encode(images: "enlarge"),
        "refine": Optimize(latents: "encode", low: "scene.train", steps: 2, guidance: Vsd(warm_up: 2)),
    },
)"#;

#[test]
fn an_exported_lora_does_what_the_runs_own_does() {
    let space = Space::new();
    fs::write(space.path("learnt.ron"), LEARNT).unwrap();
    space.ok(&["run", "learnt.ron", "--device", "cpu"]);
    let folder = "out/learnt/refine/lora";
    let said = space.ok(&[
        "export",
        "kohya",
        folder,
        "-o",
        "kohya.safetensors",
        "--json",
    ]);
    let told = said.json();
    assert!(told["layers"].as_u64().unwrap() > 0, "{told}");
    assert!(
        told["left_out"].as_u64().unwrap() > 0,
        "the camera embedding has no place in that layout: {told}"
    );
    save(&space.path("in.safetensors"), &inputs());
    let own = space.path(&format!("{folder}/pytorch_lora_weights.safetensors"));
    let exported = space.path("kohya.safetensors");
    let [own, exported] = [own, exported].map(|lora| lora.to_str().unwrap().to_owned());
    let asked: [(&str, &[&str]); 3] = [
        ("without", &[]),
        ("own", &["--lora", &own]),
        ("exported", &["--lora", &exported]),
    ];
    let [without, own, exported] = asked.map(|(name, lora)| {
        let said = ask(&space, name, lora);
        assert_eq!(said.code, 0, "{}", said.err);
        fs::read(space.path(name)).unwrap()
    });
    assert!(own != without, "the LoRA has learnt nothing");
    assert!(own == exported, "another layout, other bytes");
}
