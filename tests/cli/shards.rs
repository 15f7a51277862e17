//! Stages by shards, and stages one by one: what a cluster computes is what one machine computes.

use std::fs;

use serde_json::{Value, json};

use crate::space::Space;

/// A field, its renders, and their enlargement.
const RENDERS: &str = r#"(
    name: "renders",
    stages: {
        "scene": Scene(source: Procedural(views: 6, size: (32, 24), samples: 1), downscale: 2, holdout: 6),
        "fit": Fit(images: "scene.train", steps: 2),
        "render": Render(field: "fit", cameras: "scene.train"),
        "up": Interpolate(images: "render", factor: 2),
    },
)"#;

/// Photos that are enlarged, encoded, refined and decoded.
const REFINED: &str = r#"(
    name: "refined",
    stages: {
        "scene": Scene(source: Procedural(views: 6, size: (32, 24), samples: 1), downscale: 2, holdout: 6),
        "up": Interpolate(images: "scene.train", factor: 4),
        "encode": Encode(images: "up"),
        "optimize": Optimize(latents: "encode", low: "scene.train", guidance: Sds(), steps: 1, batch: 1),
        "decode": Decode(
            latents: "optimize", mode: Residual, residuals: "optimize.residuals", images: "up",
            low: "scene.train", back_projection: 1,
        ),
    },
)"#;

fn space_of(pipeline: &str) -> Space {
    let space = Space::new();
    fs::write(space.path("shards.ron"), pipeline).unwrap();
    space
}

/// The semantic digests of a stage's outputs, as its stamp says them.
fn outputs(space: &Space, stage: &str, more: &[&str]) -> Value {
    space.ok(&[
        &[
            "run",
            "shards.ron",
            "--only",
            stage,
            "--stamp",
            "stamps/one.json",
        ],
        more,
    ]
    .concat());
    serde_json::from_slice::<Value>(&fs::read(space.path("stamps/one.json")).unwrap()).unwrap()["outputs"].clone()
}

#[test]
fn shards_of_a_render_join_to_the_very_images_of_the_whole() {
    let space = space_of(RENDERS);
    space.ok(&["run", "shards.ron"]);
    let whole = outputs(&space, "render", &[]);
    assert_eq!(space.mode("stamps/one.json"), space.mode("shards.ron"));
    let sharded = ["--set", "render.shards=3"];
    let run = space
        .ok(&[&["run", "shards.ron", "--json"], &sharded[..]].concat())
        .last();
    assert_eq!(
        run["ran"],
        json!(["render", "render.1", "render.2", "render.3"]),
        "what reads the images is spared"
    );
    assert_eq!(outputs(&space, "render", &sharded), whole);
    assert_eq!(
        space.files("out/renders/render.3/images").len(),
        2,
        "one of five views, and the cameras"
    );
}

#[test]
fn shards_that_enlarge_encode_and_decode_join_to_the_whole() {
    let space = space_of(REFINED);
    space.ok(&["run", "shards.ron"]);
    let stages = ["up", "encode", "decode"];
    let wholes = stages.map(|stage| outputs(&space, stage, &[]));
    let sharded = [
        "--set=up.shards=4",
        "--set=encode.shards=4",
        "--set=decode.shards=4",
    ];
    let run = space
        .ok(&[&["run", "shards.ron", "--json"], &sharded[..]].concat())
        .last();
    let parts = stages.map(|stage| (1..=4).map(move |part| format!("{stage}.{part}")));
    let mut ran: Vec<String> = parts.into_iter().flatten().collect();
    ran.extend(stages.map(str::to_owned));
    ran.sort();
    assert_eq!(run["ran"], json!(ran), "what reads the latents is spared");
    assert_eq!(stages.map(|stage| outputs(&space, stage, &sharded)), wholes);
    let of_part = |part| {
        space
            .files(&format!("out/refined/decode.{part}/images"))
            .len()
    };
    assert_eq!(
        [1, 2, 3, 4].map(of_part),
        [3, 2, 2, 2],
        "five views, and cameras in each part"
    );
}

#[test]
fn a_stage_alone_needs_the_results_that_it_reads_and_computes_nothing_else() {
    let space = space_of(RENDERS);
    let only = |stage| {
        [
            "run",
            "shards.ron",
            "--set=render.shards=2",
            "--json",
            "--only",
            stage,
        ]
    };
    let early = space.say(&only("render.2"));
    assert_eq!(early.code, 3);
    assert!(
        early.err.contains("`render.2` cannot run alone yet"),
        "{}",
        early.err
    );
    for stage in ["scene", "fit", "render.2", "render.1", "render", "up"] {
        assert_eq!(space.ok(&only(stage)).last()["ran"], json!([stage]));
    }
    assert_eq!(
        space
            .ok(&["run", "shards.ron", "--set=render.shards=2", "--json"])
            .last()["ran"],
        json!([])
    );
}

#[test]
fn more_shards_than_views_are_a_clear_error() {
    let refused = |space: &Space, stage: &str| {
        let said = space.say(&["run", "shards.ron", &format!("--set={stage}.shards=6")]);
        assert_eq!(said.code, 1);
        let message = format!("{stage}.6: error: `shards` is 6, but there are only 5 views");
        assert!(said.err.contains(&message), "{}", said.err);
    };
    refused(&space_of(RENDERS), "render");
    let space = space_of(REFINED);
    for stage in ["up", "encode", "decode"] {
        refused(&space, stage);
    }
}
