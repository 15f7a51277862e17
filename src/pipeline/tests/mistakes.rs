//! Mistakes as users make them: each is pointed at, and what would help is said.

use super::{TWO_ROUNDS, load};

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
fn there_is_no_lora_of_all_shards_together() {
    let text = TWO_ROUNDS.replace("latents: \"optimize\"", "latents: \"optimize.lora\"");
    let (_, message, _) = problem(&text, &["loop.optimize.shards=2"]);
    assert!(message.contains("has no output `lora`"), "{message}");
}
