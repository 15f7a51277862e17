//! Pipelines as users write them, and mistakes as users make them.

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

/// Where the problem is, what it is, and what would help.
fn problem(text: &str, sets: &[&str]) -> (String, String, String) {
    let problem = load(text, sets).err().expect("a problem");
    (
        problem.place(),
        problem.to_string(),
        problem.advice().unwrap_or_default().to_owned(),
    )
}

fn broken(from: &str, to: &str) -> (String, String, String) {
    assert!(TWO_ROUNDS.contains(from));
    problem(&TWO_ROUNDS.replacen(from, to, 1), &[])
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
fn mistakes_in_a_file_are_pointed_at() {
    let (place, message, help) = broken("Fit(", "Fitt(");
    assert_eq!(
        (place.as_str(), help.as_str()),
        ("p.ron:6:16", "did you mean `Fit`?"),
        "{message}"
    );
    let (place, message, help) = broken("steps: 10", "stps: 10");
    assert_eq!(
        (place.as_str(), help.as_str()),
        ("p.ron:6:43", "did you mean `steps`?"),
        "{message}"
    );
    let (place, message, help) = broken("\"scene.train\", steps", "\"scen.train\", steps");
    assert_eq!(message, "there is no stage `scen` to refer to");
    assert_eq!(
        (place.as_str(), help.as_str()),
        ("p.ron:6:28", "did you mean `scene`?")
    );
    let (place, message, help) = broken("\"scene.train\", steps", "\"scene.trian\", steps");
    assert_eq!(message, "`scene` has no output `trian`");
    assert_eq!(
        (place.as_str(), help.as_str()),
        ("p.ron:6:28", "did you mean `train`?")
    );
    let (place, message, _) = broken(
        "Interpolate(images: \"loop.images\")",
        "Interpolate(images: \"loop.field\")",
    );
    assert_eq!(
        message,
        "`images` takes images, but `loop.2.sync.field` is field"
    );
    assert_eq!(place, "p.ron:20:37");
    let (place, message, help) = broken("\"loop.images\"", "\"loop.image\"");
    assert_eq!(message, "the loop `loop` has no result `image`");
    assert_eq!(
        (place.as_str(), help.as_str()),
        ("p.ron:20:37", "did you mean `images`?")
    );
    let (place, message, _) = broken("Encode(images: \"up\")", "Encode()");
    assert_eq!(
        message,
        "input `images` is not connected: it takes images of another stage"
    );
    assert_eq!(place, "p.ron:13:17");
    assert_eq!(
        broken("\"@field\", cameras", "\"@feld\", cameras").2,
        "did you mean `field`?"
    );
    assert_eq!(
        broken("count: 2", "count: 0"),
        (
            "p.ron:8:20".into(),
            "`count` is 0; it must be 1 to 10000".into(),
            String::new()
        )
    );
    assert_eq!(
        broken("\"field\": \"sync\",", "").1,
        "`field` is carried, but `next` does not say what it is in the next round"
    );
    assert_eq!(
        broken("\"fit\": Fit", "\"scene\": Fit").1,
        "`scene` is defined twice"
    );
    assert_eq!(
        broken("\"last\"", "\"la.st\"").1,
        "`la.st` is no name: names are a letter, then letters, digits, `_` and `-`"
    );
    assert_eq!(broken("\"p\"", "\"../p\"").0, "p.ron:2:11");
    assert!(
        broken("downscale: 2", "downscale: 0")
            .1
            .starts_with("`downscale`")
    );
    assert_eq!(broken("downscale: 2", "downscale: 0").0, "p.ron:5:35");
}

#[test]
fn circles_are_refused() {
    let text = r#"(name: "p", stages: {"a": Interpolate(images: "b"), "b": Interpolate(images: "a"), "c": Interpolate(images: "b")})"#;
    assert_eq!(
        problem(text, &[]).1,
        "this stage depends on itself in a circle"
    );
}

#[test]
fn mistakes_in_set_are_pointed_at() {
    let set = |set: &str| problem(TWO_ROUNDS, &[set]);
    assert_eq!(
        set("scene.downscal=2"),
        (
            "--set:1:7".into(),
            "there is no field `downscal` here".into(),
            "did you mean `downscale`?".into()
        )
    );
    assert_eq!(set("scen.downscale=2").2, "did you mean `scene`?");
    assert_eq!(
        set("loop.optimize.guidance.lora_evry=1").2,
        "did you mean `lora_every`?"
    );
    assert_eq!(set("loop.cont=1").2, "did you mean `count`?");
    assert_eq!(
        set("loop.count=0"),
        (
            "--set:1:12".into(),
            "`count` is 0; it must be 1 to 10000".into(),
            String::new()
        )
    );
    assert_eq!(set("loop.up.filter=Lanczo").2, "did you mean `Lanczos`?");
    assert_eq!(set("scene.downscale=\"x\"").0, "--set:1:17");
    assert_eq!(set("scene=1").1, "this names no single value");
    assert_eq!(set("scene.downscale").1, "expected `path=value`");
    assert_eq!(
        set("scene.downscale=[1").1,
        "the value is not RON: expected `,` or `]`"
    );
    assert_eq!(set("last.images=\"fit\"").0, "--set:1:13");
    assert_eq!(set("name=\"1x\"").0, "--set:1:6");
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

#[test]
fn there_is_no_lora_of_all_shards_together() {
    let text = TWO_ROUNDS.replace("latents: \"optimize\"", "latents: \"optimize.lora\"");
    let (_, message, _) = problem(&text, &["loop.optimize.shards=2"]);
    assert!(message.contains("has no output `lora`"), "{message}");
}
