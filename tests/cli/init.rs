//! `init`: from a folder of posed photos to pictures of four times their size.

use std::fs;

use crate::scenes::{as_colmap, exported};
use crate::space::Space;
use crate::whole::SHORT;

/// Photos of 32x32 pixels in COLMAP's layout, in `photos`.
fn photos() -> Space {
    let space = Space::new();
    exported(&space, "object", 64);
    as_colmap(&space);
    space
}

/// The fewest steps, for a scene of its own.
fn short() -> Vec<&'static str> {
    let own = |set: &&&str| !set.contains("scene.");
    let more = ["--set=enlarge.filter=Bicubic"];
    SHORT.iter().filter(own).copied().chain(more).collect()
}

#[test]
fn photos_become_pictures_of_four_times_their_size() {
    let space = photos();
    let said = space.ok(&["init", "photos"]);
    assert!(said.out.contains("wrote photos.ron"), "{}", said.out);
    assert!(
        said.out.contains("srnerf-dag run photos.ron"),
        "{}",
        said.out
    );
    let run = space.ok(&[&["run", "photos.ron"], &short()[..]].concat());
    assert!(run.out.contains("pictures/color"), "{}", run.out);
    let folder = space.path("out/photos/pictures/color");
    let picture = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.extension().is_some_and(|end| end == "png"))
        .unwrap();
    assert_eq!(image::image_dimensions(picture).unwrap(), (128, 128));
}

#[test]
fn a_pipeline_to_judge_by_holds_photos_out() {
    let space = photos();
    space.ok(&["init", "photos", "--judge", "-o", "judge.ron"]);
    let plan = space.ok(&["plan", "judge.ron"]);
    assert!(plan.out.contains("evaluate"), "{}", plan.out);
}

#[test]
fn what_lies_there_is_not_lost() {
    let space = photos();
    space.ok(&["init", "photos"]);
    let before = fs::read(space.path("photos.ron")).unwrap();
    let said = space.say(&["init", "photos", "--judge"]);
    assert_eq!(said.code, 2, "{}", said.err);
    assert!(said.err.contains("cannot write photos.ron"), "{}", said.err);
    assert!(said.err.contains("--output FILE"), "{}", said.err);
    assert_eq!(fs::read(space.path("photos.ron")).unwrap(), before);
}

#[test]
fn photos_without_poses_come_with_the_way_to_get_them() {
    let space = Space::new();
    fs::create_dir(space.path("mine")).unwrap();
    let said = space.say(&["init", "mine"]);
    assert_eq!(said.code, 2, "{}", said.err);
    assert!(said.err.contains("mine has no poses"), "{}", said.err);
    assert!(said.err.contains("import mine"), "{}", said.err);
    let said = space.say(&["init"]);
    assert_eq!(said.code, 2, "{}", said.err);
    assert!(said.err.contains("no photos are named"), "{}", said.err);
    let said = space.say(&["init", "yours"]);
    assert_eq!(said.code, 2, "{}", said.err);
    assert!(said.err.contains("there is no yours"), "{}", said.err);
}
