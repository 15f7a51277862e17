//! Files that extend others, and arms: what they come to, and mistakes in them as users make them.

use std::collections::BTreeMap;

use super::graph::Graph;
use super::problem::{Problem, SourceText};
use super::set::Override;

const BASE: &str = r#"(
    name: "base",
    seed: 7,
    stages: {
        "scene": Scene(downscale: 2),
        "fit": Fit(images: "scene.train", steps: 10),
        "up": Interpolate(images: "scene.train", factor: 2),
        "sync": Sync(field: "fit", images: "up", low: "scene.train", steps: 20),
        "evaluate": Evaluate(
            field: "sync", baseline: "fit", truth: "scene.test", low: "scene.test_low", train: "scene.train",
        ),
    },
)"#;

fn source(name: &str, text: &str) -> SourceText {
    SourceText {
        name: name.into(),
        text: text.into(),
    }
}

fn load(text: &str, sets: &[&str]) -> Result<Graph, Problem> {
    let overrides: Vec<Override> = sets
        .iter()
        .map(|set| Override::read(set).unwrap())
        .collect();
    super::load(
        &[source("p.ron", text), source("base.ron", BASE)],
        &overrides,
    )
}

fn names(graph: &Graph) -> Vec<&str> {
    graph.nodes.iter().map(|node| node.name.as_str()).collect()
}

/// How many stages there are, those that several arms have counted for each.
fn stages(graph: &Graph) -> usize {
    graph.nodes.iter().map(|node| node.names().count()).sum()
}

fn steps(graph: &Graph, name: &str) -> u64 {
    let mut nodes = graph.nodes.iter();
    let node = nodes.find(|node| node.names().any(|other| other == name));
    node.unwrap().params["steps"].as_u64().unwrap()
}

/// Where the problem is, what it is, and what would help.
fn problem(text: &str) -> (String, String, String) {
    let problem = load(text, &[]).err().expect("a problem");
    let advice = problem.advice().unwrap_or_default().to_owned();
    (problem.place(), problem.to_string(), advice)
}

#[test]
fn a_file_says_only_how_it_differs_from_another() {
    let text = r#"(
        name: "p",
        base: "base.ron",
        without: ["up", "sync"],
        set: { "fit.steps": 99, "evaluate.field": "fit" },
        stages: { "film": Film(images: "fly"), "fly": Render(field: "fit", cameras: "scene.train") },
    )"#;
    let graph = load(text, &[]).unwrap();
    assert_eq!(graph.pipeline, "p");
    assert_eq!(names(&graph), ["scene", "fit", "evaluate", "fly", "film"]);
    assert_eq!(steps(&graph, "fit"), 99);
    assert!(graph.nodes.iter().all(|node| node.seed == 7));
    assert_eq!(steps(&load(text, &["fit.steps=3"]).unwrap(), "fit"), 3);
}

#[test]
fn a_mistake_is_of_the_file_that_has_the_last_word() {
    let middle = r#"(name: "m", base: "base.ron", set: { "name": "n", "up.factor": 3 })"#;
    for (text, place) in [
        (r#"(name: "1x", base: "m.ron")"#, "p.ron:1:8"),
        (
            r#"(name: "p", base: "m.ron", stages: { "up": Interpolate(images: "scene.train", factor: 0) })"#,
            "p.ron:1:87",
        ),
    ] {
        let files = [
            source("p.ron", text),
            source("m.ron", middle),
            source("base.ron", BASE),
        ];
        let problem = super::load(&files, &[]).err().expect("a problem");
        assert_eq!(problem.place(), place, "{problem}");
    }
}

#[test]
fn a_file_extends_another_without_changing_what_it_does_not_name() {
    let own = super::load(&[source("base.ron", BASE)], &[]).unwrap();
    let extended = load(r#"(name: "p", base: "base.ron")"#, &[]).unwrap();
    let told = |graph: &Graph| -> BTreeMap<String, (u64, String)> {
        let tell =
            |node: &super::graph::Node| (node.name.clone(), (node.seed, node.params.to_string()));
        graph.nodes.iter().map(tell).collect()
    };
    assert_eq!(told(&own), told(&extended));
}

const ARMS: &str = r#"(
    name: "p",
    base: "base.ron",
    targets: ["evaluate"],
    arms: {
        "plain": { "evaluate.field": "fit" },
        "ours": {},
        "long": { "sync.steps": 200 },
    },
    baseline: "ours",
    bound: "long",
)"#;

#[test]
fn arms_share_every_stage_in_which_they_do_not_differ() {
    let graph = load(ARMS, &[]).unwrap();
    let expected = [
        "plain/scene",
        "plain/fit",
        "plain/evaluate",
        "ours/up",
        "ours/sync",
        "ours/evaluate",
        "long/sync",
        "long/evaluate",
    ];
    assert_eq!(names(&graph), expected);
    assert_eq!(stages(&graph), 13);
    let all: Vec<&str> = graph.nodes[0].names().collect();
    assert_eq!(all, ["plain/scene", "ours/scene", "long/scene"]);
    assert_eq!(steps(&graph, "long/sync"), 200);
    let experiment = graph.experiment.as_ref().unwrap();
    assert_eq!(experiment.size(3), "3 arms");
    assert_eq!(
        (experiment.baseline.as_str(), experiment.bound.as_deref()),
        ("ours", Some("long"))
    );
    assert_eq!(experiment.arms[2].differences["sync.steps"], "200");
    assert_eq!(graph.of_arm("plain").unwrap(), [0, 1, 2].into());
    assert_eq!(graph.find("sync").unwrap(), [4, 6].into());
    assert_eq!(graph.find("long/sync").unwrap(), [6].into());
    assert_eq!(graph.find("long/fit").unwrap(), [1].into());
}

#[test]
fn an_override_is_of_all_arms_and_an_arm_has_the_last_word() {
    let graph = load(ARMS, &["fit.steps=5", "sync.steps=50"]).unwrap();
    assert_eq!(steps(&graph, "long/fit"), 5);
    assert_eq!(steps(&graph, "ours/sync"), 50);
    assert_eq!(steps(&graph, "long/sync"), 200);
}

#[test]
fn each_seed_has_stages_of_its_own_but_the_same_photos() {
    let text = ARMS.replace("baseline:", "seeds: [0, 1, 2], baseline:");
    let graph = load(&text, &[]).unwrap();
    assert_eq!(
        graph.experiment.as_ref().unwrap().size(3),
        "3 arms x 3 seeds"
    );
    // One scene; for each seed a fit, an enlargement, two synchronizations and three evaluations.
    assert_eq!((stages(&graph), graph.nodes.len()), (39, 1 + 3 * 7));
    let seed = |name: &str| {
        let mut nodes = graph.nodes.iter();
        nodes
            .find(|node| node.names().any(|other| other == name))
            .unwrap()
            .seed
    };
    assert_eq!(seed("ours/seed_2/scene"), 7);
    assert_eq!(seed("ours/seed_2/fit"), 2);
}

#[test]
fn a_matrix_has_an_arm_for_each_combination() {
    let text = r#"(
        name: "p",
        base: "base.ron",
        matrix: { "fit.steps": [10, 20], "up.filter": [Bicubic, Lanczos3] },
        exclude: [{ "fit.steps": 20, "up.filter": Bicubic }],
        include: [{ "fit.steps": 40 }],
    )"#;
    let problem = problem(text);
    assert!(problem.1.contains("Lanczos3"), "{problem:?}");
    assert_eq!(problem.0, "p.ron:4:65");
    let graph = load(&text.replace("Lanczos3", "Lanczos"), &[]);
    let Ok(graph) = graph else {
        panic!("{}", graph.err().unwrap());
    };
    let arms = &graph.experiment.as_ref().unwrap().arms;
    let arms: Vec<&str> = arms.iter().map(|arm| arm.name.as_str()).collect();
    let expected = [
        "steps-10_filter-Bicubic",
        "steps-10_filter-Lanczos",
        "steps-20_filter-Lanczos",
        "steps-40",
    ];
    assert_eq!(arms, expected);
}

#[test]
fn mistakes_in_differences_are_shown_where_they_stand() {
    let with = |from: &str, to: &str| {
        assert!(ARMS.contains(from));
        problem(&ARMS.replacen(from, to, 1))
    };
    let (place, message, help) = with("sync.steps", "synk.steps");
    assert_eq!(
        (place.as_str(), help.as_str()),
        ("p.ron:8:20", "did you mean `sync`?")
    );
    assert!(message.contains("`synk`"));
    let (place, message, _) = with("200", "\"many\"");
    assert_eq!(place, "p.ron:8:33");
    assert!(message.contains("steps"), "{message}");
    let (place, message, _) = with("200", "0");
    assert_eq!(place, "p.ron:8:33");
    assert!(message.contains("steps"), "{message}");
    let (place, _, help) = with("baseline: \"ours\"", "baseline: \"our\"");
    assert_eq!(
        (place.as_str(), help.as_str()),
        ("p.ron:10:15", "did you mean `ours`?")
    );
    let (place, message, _) = with("\"long\"", "\"../long\"");
    assert_eq!(place, "p.ron:8:9");
    assert!(message.contains("is no name"), "{message}");
    let (place, message, _) = with("\"long\"", "\"ours\"");
    assert_eq!(
        (place.as_str(), message.as_str()),
        ("p.ron:8:9", "`ours` is given twice")
    );
    let (place, message, _) = with("[\"evaluate\"]", "[\"evaluation\"]");
    assert_eq!(place, "p.ron:4:14");
    assert!(message.contains("did you mean `evaluate`?"), "{message}");
    let (place, ..) = with("{ \"sync.steps\": 200 }", "[200]");
    assert_eq!(place, "p.ron:8:17");
    let (place, message, _) = with("targets", "without: [\"top\"], targets");
    assert_eq!(
        (place.as_str(), message.as_str()),
        ("p.ron:4:14", "there is no stage `top`")
    );
    let (place, ..) = with("targets", "seeds: [1, 1], targets");
    assert_eq!(place, "p.ron:4:12");
    // What the base says is shown in the base.
    let (place, message, _) = with("targets: [\"evaluate\"]", "without: [\"up\"]");
    assert_eq!(place, "base.ron:8:44");
    assert!(message.contains("no stage `up`"), "{message}");
}

#[test]
fn values_without_a_file_that_they_are_of_are_refused() {
    let text = r#"(name: "p", set: { "fit.steps": 3 })"#;
    let problem = super::load(&[source("p.ron", text)], &[]).err().unwrap();
    assert_eq!(problem.place(), "p.ron:1:18");
}

#[test]
fn bases_are_found_beside_the_files_that_extend_them() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("base.ron", BASE);
    write(
        "a.ron",
        r#"(name: "a", base: "base.ron", set: { "fit.steps": 30 })"#,
    );
    write("b.ron", r#"(name: "b", base: "a.ron")"#);
    write("itself.ron", r#"(name: "i", base: "itself.ron")"#);
    write("lost.ron", r#"(name: "l", base: "gone.ron")"#);
    let files =
        |name: &str| super::with_bases(SourceText::read(&folder.path().join(name)).unwrap());
    let graph = super::load(&files("b.ron").unwrap(), &[]).unwrap();
    assert_eq!(graph.pipeline, "b");
    assert_eq!(steps(&graph, "fit"), 30);
    let itself = files("itself.ron").unwrap_err();
    assert_eq!(itself.advice(), Some("does one of them extend itself?"));
    let lost = files("lost.ron").unwrap_err();
    assert!(lost.place().ends_with("lost.ron:1:19"), "{}", lost.place());
}
