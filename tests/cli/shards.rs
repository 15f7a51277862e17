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

fn renders() -> Space {
    let space = Space::new();
    fs::write(space.path("renders.ron"), RENDERS).unwrap();
    space
}

/// The semantic digests of a stage's outputs, as its stamp says them.
fn outputs(space: &Space, stage: &str, more: &[&str]) -> Value {
    space.ok(&[
        &[
            "run",
            "renders.ron",
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
    let space = renders();
    space.ok(&["run", "renders.ron"]);
    let whole = outputs(&space, "render", &[]);
    assert_eq!(space.mode("stamps/one.json"), space.mode("renders.ron"));
    let sharded = ["--set", "render.shards=3"];
    let run = space
        .ok(&[&["run", "renders.ron", "--json"], &sharded[..]].concat())
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
fn a_stage_alone_needs_the_results_that_it_reads_and_computes_nothing_else() {
    let space = renders();
    let only = |stage| {
        [
            "run",
            "renders.ron",
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
            .ok(&["run", "renders.ron", "--set=render.shards=2", "--json"])
            .last()["ran"],
        json!([])
    );
}

#[test]
fn more_shards_than_views_are_a_clear_error() {
    let space = renders();
    let said = space.say(&["run", "renders.ron", "--set=render.shards=6"]);
    assert_eq!(said.code, 1);
    assert!(
        said.err
            .contains("render.6: error: `shards` is 6, but there are only 5 views"),
        "{}",
        said.err
    );
}
