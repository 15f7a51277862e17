//! `import`: poses for photos that have none. In COLMAP's place is a script that prints what COLMAP
//! prints, and has a reconstruction ready; `tests/import/real.sh` asks a real one.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt;

use crate::files::assert_same_files;
use crate::scenes::{as_colmap, exported};
use crate::space::{Said, Space};

/// What stands in COLMAP's place.
const COLMAP: &str = r#"#!/bin/sh
echo "$@" >> asked
for word in "$@"; do last=$word; done
case "$1" in
    help) echo 'COLMAP 3.8 -- Structure-from-Motion (Commit Unknown on Unknown without CUDA)' ;;
    feature_extractor)
        [ "$2" = --help ] && echo '  --SiftExtraction.use_gpu arg (=1)' && exit
        echo 'Processed file [1/2]'; echo 'Processed file [2/2]' ;;
    mapper)
        [ "$2" = --help ] && exit
        [ -e broken ] && echo 'a word' && echo 'No good initial image pair found.' >&2 && exit 3
        echo 'Registering image #2 (2)'
        mkdir -p "$last/0" && cp reconstruction/* "$last/0" ;;
esac
"#;

/// Photos without poses in `shoes`, and a program `colmap` that knows the poses.
fn photos() -> Space {
    let space = Space::new();
    exported(&space, "object", 64);
    as_colmap(&space);
    fs::rename(space.path("photos/sparse/0"), space.path("reconstruction")).unwrap();
    fs::rename(space.path("photos/images"), space.path("shoes")).unwrap();
    let program = space.path("colmap");
    fs::write(&program, COLMAP).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    space
}

fn import(space: &Space, more: &[&str]) -> Said {
    space.say(&[&["import", "shoes", "--colmap", "./colmap"], more].concat())
}

#[test]
fn photos_without_poses_become_a_pipeline_that_runs() {
    let space = photos();
    // One of the photos lies elsewhere.
    let photo = space.path("shoes/train_000.png");
    fs::rename(&photo, space.path("elsewhere.png")).unwrap();
    std::os::unix::fs::symlink("../elsewhere.png", &photo).unwrap();
    let before = space.files("shoes");
    let said = import(&space, &[]);
    assert_eq!(said.code, 0, "{}", said.err);
    assert!(said.err.contains("poses by COLMAP 3.8"), "{}", said.err);
    let good = "4 of 4 photos have a pose, 20 points, mean reprojection error 0.50 pixels";
    assert!(said.err.contains(good), "{}", said.err);
    assert!(said.out.contains("wrote shoes.ron"), "{}", said.out);
    space.assert_files("shoes", &before);
    assert_same_files(&space, "shoes", "shoes_posed/images");
    let plan = space.ok(&["plan", "shoes.ron"]);
    assert!(plan.out.contains("pictures"), "{}", plan.out);
    // Without CUDA the graphics card would need a window system.
    let asked = fs::read_to_string(space.path("asked")).unwrap();
    assert!(asked.contains("--SiftExtraction.use_gpu 0"), "{asked}");
    assert!(asked.contains("--ImageReader.single_camera 1"), "{asked}");
}

#[test]
fn too_few_poses_are_refused_with_what_helps() {
    let space = photos();
    for i in 0..6 {
        let other = space.path(&format!("shoes/other_{i}.png"));
        fs::copy(space.path("shoes/train_001.png"), other).unwrap();
    }
    let said = import(&space, &[]);
    assert_eq!(said.code, 5, "{}", said.err);
    assert!(
        said.err.contains("4 of 10 photos found a pose"),
        "{}",
        said.err
    );
    assert!(said.err.contains("overlap"), "{}", said.err);
    assert!(!space.path("shoes_posed").exists() && !space.path("shoes.ron").exists());
    let log = fs::read_to_string(space.path("shoes_posed.part/import.log")).unwrap();
    assert!(log.contains("Registering image #2 (2)"), "{log}");
    // Who takes fewer gets them, and the failed try is gone.
    let said = import(&space, &["--least", "0.3"]);
    assert_eq!(said.code, 0, "{}", said.err);
    assert!(!space.path("shoes_posed.part").exists());
}

#[test]
fn a_program_that_fails_is_heard() {
    let space = photos();
    fs::write(space.path("broken"), "").unwrap();
    let said = import(&space, &[]);
    assert_eq!(said.code, 1, "{}", said.err);
    assert!(said.err.contains("finding poses failed"), "{}", said.err);
    assert!(
        said.err.contains("No good initial image pair"),
        "{}",
        said.err
    );
    assert!(said.err.contains("import.log"), "{}", said.err);
}

#[test]
fn what_cannot_be_done_is_said_before_anything_is() {
    let space = photos();
    let nowhere = [("PATH", "/nowhere".to_owned())];
    let said = space.say_with(&nowhere, &["import", "shoes"]);
    assert_eq!(said.code, 2, "{}", said.err);
    assert!(said.err.contains("pip install pycolmap"), "{}", said.err);
    let said = space.say(&["import", "shoes", "--colmap", "./tiny.ron"]);
    assert_eq!(said.code, 2, "{}", said.err);
    assert!(said.err.contains("tiny.ron is no COLMAP"), "{}", said.err);
    fs::create_dir(space.path("empty")).unwrap();
    let said = space.say(&["import", "empty", "--colmap", "./colmap"]);
    assert_eq!(said.code, 3, "{}", said.err);
    assert!(said.err.contains("empty holds no photos"), "{}", said.err);
    let said = space.say(&["import", "film.mp4", "--colmap", "./colmap"]);
    assert_eq!(said.code, 2, "{}", said.err);
    let said = import(&space, &["--least", "60"]);
    assert_eq!(said.code, 2, "{}", said.err);
    assert!(said.err.contains("at most 1"), "{}", said.err);
    fs::write(space.path("shoes.ron"), "mine").unwrap();
    let said = import(&space, &[]);
    assert_eq!(said.code, 2, "{}", said.err);
    assert!(
        said.err.contains("shoes.ron is there already"),
        "{}",
        said.err
    );
    let said = import(&space, &["-o", "other/"]);
    assert_eq!(said.code, 0, "{}", said.err);
    assert!(space.path("other/sparse").exists() && space.path("other.ron").exists());
}
