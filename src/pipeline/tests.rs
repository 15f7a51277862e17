//! Pipelines as users write them, and mistakes as users make them.

mod mistakes;

use super::graph::Graph;
use super::problem::{Problem, SourceText};
use super::set::Override;

const TWO_ROUNDS: &str = r#"(
    name: "p",
    seed: 7,
    stages: {
        "scene": Scene(downscale: 2),
        "fit": Fit(images: "scene.train", steps: 10),
        "loop": Rounds(
            count: 2,
            carry: { "field": "fit" },
            stages: {
                "render": Render(field: "@field", cameras: "scene.train"),
                "up": Interpolate(images: "render", factor: 2),
                "encode": Encode(images: "up"),
                "optimize": Optimize(latents: "encode", low: "scene.train", guidance: Vsd(lora_every: 3)),
                "decode": Decode(latents: "optimize"),
                "sync": Sync(field: "@field", images: "decode", low: "scene.train"),
            },
            next: { "field": "sync", "images": "decode" },
        ),
        "last": Interpolate(images: "loop.images"),
    },
)"#;

fn load(text: &str, sets: &[&str]) -> Result<Graph, Problem> {
    let source = SourceText {
        name: "p.ron".into(),
        text: text.into(),
    };
    let overrides = sets
        .iter()
        .map(|set| Override::read(set))
        .collect::<Result<Vec<_>, _>>()?;
    super::load(&[source], &overrides)
}

/// Who feeds the inputs of a stage: `field=fit.field`.
fn wires(graph: &Graph, name: &str) -> Vec<String> {
    let node = graph.nodes.iter().find(|node| node.name == name).unwrap();
    node.wires
        .iter()
        .map(|wire| {
            format!(
                "{}={}.{}",
                wire.input, graph.nodes[wire.from].name, wire.output
            )
        })
        .collect()
}

fn param<'g>(graph: &'g Graph, name: &str, pointer: &str) -> &'g serde_json::Value {
    let node = graph.nodes.iter().find(|node| node.name == name).unwrap();
    node.params.pointer(pointer).unwrap()
}

#[test]
fn what_ten_thousand_rounds_hand_on_is_what_came_in() {
    let text = r#"(name: "p", stages: {
        "a": Scene(),
        "b": Scene(),
        "loop": Rounds(
            count: COUNT,
            carry: { "x": "a.train", "y": "a.train", "z": "b.train" },
            stages: { "up": Interpolate(images: "@y", factor: 2), "down": Interpolate(images: "@x", factor: 2) },
            next: { "x": "@x", "y": "@z", "z": "@y", "up": "up" },
        ),
        "last": Interpolate(images: "loop.y", factor: 2),
    })"#;
    let graph = load(&text.replace("COUNT", "10000"), &[]).unwrap();
    assert_eq!(wires(&graph, "loop.10000.down"), ["images=a.train"]);
    assert_eq!(wires(&graph, "loop.9999.up"), ["images=a.train"]);
    assert_eq!(wires(&graph, "loop.10000.up"), ["images=b.train"]);
    // What comes out is what would go into the round after the last.
    assert_eq!(wires(&graph, "last"), ["images=a.train"]);
}

#[test]
fn loops_are_unrolled_and_carry_their_state() {
    let graph = load(TWO_ROUNDS, &[]).unwrap();
    let names: Vec<&str> = graph.nodes.iter().map(|node| node.name.as_str()).collect();
    assert_eq!(names.len(), 15);
    assert_eq!(names[..4], ["scene", "fit", "loop.1.render", "loop.1.up"]);
    assert_eq!(
        wires(&graph, "loop.1.render"),
        ["field=fit.field", "cameras=scene.train"]
    );
    assert_eq!(
        wires(&graph, "loop.2.render"),
        ["field=loop.1.sync.field", "cameras=scene.train"]
    );
    assert_eq!(wires(&graph, "last"), ["images=loop.2.decode.images"]);
}

#[test]
fn rounds_have_seeds_of_their_own_that_do_not_depend_on_their_number() {
    let two = load(TWO_ROUNDS, &[]).unwrap();
    let five = load(TWO_ROUNDS, &["loop.count=5"]).unwrap();
    let seed = |graph: &Graph, name: &str| {
        graph
            .nodes
            .iter()
            .find(|node| node.name == name)
            .unwrap()
            .seed
    };
    assert_eq!(seed(&two, "scene"), 7);
    assert_ne!(seed(&two, "loop.1.render"), seed(&two, "loop.2.render"));
    assert_eq!(seed(&two, "loop.2.render"), seed(&five, "loop.2.render"));
}

#[test]
fn loops_nest() {
    let inner = r#""in": Rounds(count: 2, carry: {"x": "@image"}, stages: {"up": Interpolate(images: "@x")}, next: {"x": "up"})"#;
    let text = format!(
        r#"(name: "p", stages: {{"scene": Scene(), "out": Rounds(count: 2, carry: {{"image": "scene"}}, stages: {{{inner}}}, next: {{"image": "in.x"}})}})"#
    );
    let graph = load(&text, &[]).unwrap();
    assert_eq!(wires(&graph, "out.1.in.1.up"), ["images=scene.train"]);
    assert_eq!(
        wires(&graph, "out.1.in.2.up"),
        ["images=out.1.in.1.up.images"]
    );
    assert_eq!(
        wires(&graph, "out.2.in.1.up"),
        ["images=out.1.in.2.up.images"]
    );
}

#[test]
fn stages_may_stand_before_what_they_read() {
    let text = r#"(name: "p", stages: {"up": Interpolate(images: "scene"), "scene": Scene()})"#;
    let names: Vec<String> = load(text, &[])
        .unwrap()
        .nodes
        .into_iter()
        .map(|node| node.name)
        .collect();
    assert_eq!(names, ["scene", "up"]);
}

#[test]
fn stages_are_found_by_loop_round_and_kind_of_step() {
    let graph = load(TWO_ROUNDS, &[]).unwrap();
    let count = |name| graph.find(name).unwrap().len();
    assert_eq!(
        (
            count("fit"),
            count("loop"),
            count("loop.2"),
            count("loop.decode"),
            count("loop.2.decode")
        ),
        (1, 12, 6, 2, 1)
    );
    let unknown = graph.find("loop.decod").unwrap_err().to_string();
    assert_eq!(
        unknown,
        "the pipeline has no stage `loop.decod`; did you mean `loop.decode`?"
    );
    assert_eq!(graph.needed(&graph.find("loop.1.render").unwrap()).len(), 3);
}

#[test]
fn set_changes_one_value_wherever_it_is() {
    let sets = [
        "scene.downscale=4",
        "loop.optimize.guidance.lora_every=1",
        "loop.up.filter=Lanczos",
        "seed=9",
        "loop.count=1",
    ];
    let graph = load(TWO_ROUNDS, &sets).unwrap();
    assert_eq!(param(&graph, "scene", "/downscale"), 4);
    assert_eq!(
        param(&graph, "loop.1.optimize", "/guidance/Vsd/lora_every"),
        1
    );
    assert_eq!(param(&graph, "loop.1.up", "/filter"), "Lanczos");
    assert_eq!(graph.nodes[0].seed, 9);
    assert_eq!(graph.nodes.len(), 9);
    let graph = load(
        TWO_ROUNDS,
        &["scene.source=Llff(path: \"fern\", size: (252, 189))"],
    )
    .unwrap();
    assert_eq!(param(&graph, "scene", "/source/Llff/path"), "fern");
    assert_eq!(param(&graph, "scene", "/source/Llff/size/1"), 189);
}

#[test]
fn a_stage_with_shards_becomes_its_parts_and_a_merge_of_its_name() {
    let graph = load(TWO_ROUNDS, &["loop.optimize.shards=2", "loop.count=1"]).unwrap();
    let names: Vec<&str> = graph.nodes.iter().map(|node| node.name.as_str()).collect();
    assert_eq!(
        names[5..8],
        ["loop.1.optimize.1", "loop.1.optimize.2", "loop.1.optimize"]
    );
    assert_eq!(
        wires(&graph, "loop.1.optimize.2"),
        ["latents=loop.1.encode.latents", "low=scene.train"]
    );
    assert_eq!(
        wires(&graph, "loop.1.optimize"),
        [
            "latents.1=loop.1.optimize.1.latents",
            "latents.2=loop.1.optimize.2.latents",
            "residuals.1=loop.1.optimize.1.residuals",
            "residuals.2=loop.1.optimize.2.residuals",
            "log.1=loop.1.optimize.1.log",
            "log.2=loop.1.optimize.2.log",
        ]
    );
    assert_eq!(
        wires(&graph, "loop.1.decode"),
        ["latents=loop.1.optimize.latents"]
    );
    assert_eq!(graph.find("loop.optimize").unwrap().len(), 3);
    let seed = |at: usize| graph.nodes[at].seed;
    assert!(
        seed(5) != seed(6) && seed(5) != seed(4),
        "parts draw numbers of their own"
    );
}
