//! The tutorial: its commands, as they stand in `docs/tutorial.md`, on a scene that takes seconds.

use std::fs;

use crate::scenes::{as_colmap, exported};
use crate::space::Space;
use crate::whole::{SHORT, pipeline};

/// The page's command lines of this program, without their comments.
fn commands(page: &str) -> Vec<String> {
    let inside = page.split("```").skip(1).step_by(2).flat_map(str::lines);
    let ours = inside.filter_map(|line| line.strip_prefix("srnerf-dag "));
    // COLMAP may not be here; `import` has transcripts of its own.
    let ours = ours.filter(|line| !line.starts_with("import "));
    ours.map(|line| line.split("  #").next().unwrap().trim().to_owned())
        .collect()
}

/// Words as a shell takes them, where only single quotes occur.
fn words(line: &str) -> Vec<String> {
    let parts = line.split('\'').enumerate();
    let mut words = Vec::new();
    for (i, part) in parts {
        if i % 2 == 1 {
            words.push(part.to_owned());
        } else {
            words.extend(part.split_whitespace().map(str::to_owned));
        }
    }
    words
}

/// The same command at the fewest steps, and with the pipelines of this repository.
fn short(line: &str) -> Vec<String> {
    let mut words = words(line);
    for word in &mut words {
        if let Some(name) = word
            .strip_prefix("pipelines/")
            .and_then(|word| word.strip_suffix(".ron"))
        {
            *word = pipeline(name);
        }
    }
    let computes = words[0] == "run" || words[0] == "plan";
    let own_photos = words
        .iter()
        .any(|word| word == "shoes.ron" || word == "judge.ron");
    let few = SHORT
        .iter()
        .filter(|set| !(own_photos && set.contains("scene.source")));
    if computes {
        words.extend(few.map(|set| (*set).to_owned()));
        words.extend(["--set=enlarge.filter=Bicubic".into()]);
    }
    if words[1..].iter().any(|word| word.ends_with("orbit.ron")) {
        words.push("--set=fly.path=Spiral(frames: 2)".into());
    }
    words
}

#[test]
fn every_command_of_the_tutorial_works() {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/tutorial.md");
    let page = fs::read_to_string(page).unwrap();
    let space = Space::new();
    exported(&space, "object", 64);
    as_colmap(&space);
    fs::rename(space.path("photos"), space.path("shoes_posed")).unwrap();
    let commands = commands(&page);
    assert!(commands.len() >= 10, "{commands:?}");
    for line in &commands {
        let words = short(line);
        space.ok(&words.iter().map(String::as_str).collect::<Vec<_>>());
    }
    assert!(space.path("field.ply").is_file());
}
