//! When all results are there, the next run only looks whether anything has changed: it says the
//! same, and is not fooled.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use serde_json::json;

use crate::space::{Space, wait_until};

/// A stage that reads photos, and one that follows.
const PHOTOS: &str = r#"(
    name: "photos",
    stages: {
        "scene": Scene(source: Llff(path: "scene"), holdout: 2),
        "up": Interpolate(images: "scene.train", factor: 2),
    },
)"#;

/// A folder with a run that had nothing to do, and remembers so.
fn up_to_date() -> Space {
    let space = Space::new();
    fs::write(space.path("photos.ron"), PHOTOS).unwrap();
    photos(&space.path("scene"), 4);
    space.ok(&["run", "photos.ron"]);
    // What has just changed may change again without a sign of it: nothing is remembered of it yet.
    wait_until("a run remembers that nothing was to be done", || {
        space.ok(&["run", "photos.ron"]);
        space.path(".srnerf/standing").exists()
    });
    space
}

/// A forward-facing scene: poses, and as many pictures of one colour.
fn photos(folder: &Path, count: usize) {
    fs::create_dir_all(folder.join("images")).unwrap();
    let mut row = Vec::new();
    for at in 0..count {
        let pose = [
            1.0, 0.0, 0.0, at as f64, 8.0, 0.0, 1.0, 0.0, 0.0, 12.0, 0.0, 0.0, 1.0, 0.0, 10.0, 1.0,
            5.0,
        ];
        row.extend(pose.iter().flat_map(|value: &f64| value.to_le_bytes()));
        image::RgbImage::from_pixel(12, 8, image::Rgb([60 * at as u8; 3]))
            .save(folder.join(format!("images/{at}.png")))
            .unwrap();
    }
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({count}, 17), }}");
    let header = format!("{header:<117}\n");
    let file = [
        b"\x93NUMPY\x01\x00",
        &(header.len() as u16).to_le_bytes()[..],
        header.as_bytes(),
        &row,
    ]
    .concat();
    fs::write(folder.join("poses_bounds.npy"), file).unwrap();
}

/// Runs once with what is remembered, and once without: both do this, and say the same of it.
fn run_both_ways(space: &Space, ran: &[&str]) {
    let remembered = space.path(".srnerf/standing");
    let plan = space.ok(&["plan", "photos.ron", "--json"]).json();
    let aside = fs::read(&remembered).unwrap();
    fs::remove_file(&remembered).unwrap();
    assert_eq!(plan, space.ok(&["plan", "photos.ron", "--json"]).json());
    fs::write(&remembered, aside).unwrap();
    assert_eq!(
        space.ok(&["run", "photos.ron", "--json"]).last()["ran"],
        json!(ran)
    );
}

#[test]
fn a_run_that_only_looks_says_what_one_says_that_reads_everything() {
    let space = up_to_date();
    let commands = [
        &["plan", "photos.ron"][..],
        &["plan", "photos.ron", "--json"],
        &["run", "photos.ron"],
        &["run", "-q", "photos.ron"],
    ];
    let quick = commands.map(|command| space.ok(command).out);
    fs::remove_file(space.path(".srnerf/standing")).unwrap();
    assert_eq!(quick, commands.map(|command| space.ok(command).out));
    // Of the six runs, the third and the fourth only looked: their records say what the others' do.
    for run in ["@6", "@4", "@3"] {
        space.ok(&["diff", run, "@1", "--exit-code"]);
    }
}

#[test]
fn a_photo_that_changes_or_comes_is_seen() {
    let space = up_to_date();
    let photo = space.path("scene/images/1.png");
    image::RgbImage::from_pixel(12, 8, image::Rgb([7; 3]))
        .save(&photo)
        .unwrap();
    run_both_ways(&space, &["scene", "up"]);
    let space = up_to_date();
    fs::write(space.path("scene/images/notes.txt"), "no photo").unwrap();
    run_both_ways(&space, &[]);
}

#[test]
fn another_question_has_another_answer() {
    let space = up_to_date();
    let run = |more: &[&str]| {
        space
            .ok(&[&["run", "photos.ron", "--json"][..], more].concat())
            .last()["ran"]
            .clone()
    };
    assert_eq!(run(&["--set", "up.filter=Lanczos"]), json!(["up"]));
    assert_eq!(run(&["--salt", "x"]), json!(["scene", "up"]));
    assert_eq!(run(&["--force", "up"]), json!(["up"]));
    assert_eq!(run(&["--out", "elsewhere"]), json!([]));
    assert!(space.files("elsewhere").len() > 3, "shown there too");
    fs::write(
        space.path("photos.ron"),
        PHOTOS.replace("factor: 2", "factor: 3"),
    )
    .unwrap();
    assert_eq!(run(&[]), json!(["up"]));
}

#[test]
fn a_plan_remembers_too_and_vouches_for_nothing_that_it_did_not_look_at() {
    let space = up_to_date();
    let remembered = space.path(".srnerf/standing");
    fs::remove_file(&remembered).unwrap();
    let slow = space.ok(&["plan", "photos.ron", "--json"]).json();
    assert!(remembered.exists());
    fs::remove_dir_all(space.path("out/photos/up")).unwrap();
    assert_eq!(space.ok(&["plan", "photos.ron", "--json"]).json(), slow);
    space.ok(&["run", "photos.ron"]);
    assert!(
        space.path("out/photos/up/images").exists(),
        "a run shows what the plan did not look at"
    );

    fs::remove_file(&remembered).unwrap();
    assert_eq!(
        space
            .say(&["plan", "photos.ron", "--set", "up.factor=3", "--exit-code"])
            .code,
        5
    );
    assert!(
        !remembered.exists(),
        "only that there is nothing to do is remembered"
    );
}

#[test]
fn what_is_lost_is_seen_and_comes_back() {
    let space = up_to_date();
    let up = space.ok(&["inspect", "up", "photos.ron", "--json"]).json();
    let file = &up["outputs"]["images"]["files"][0];
    let [key, blob, path] =
        [&up["key"], &file["blob"], &file["path"]].map(|text| text.as_str().unwrap());
    let shown = space.path("out/photos/up/images").join(path);
    let before = fs::read(&shown).unwrap();

    fs::remove_file(&shown).unwrap();
    run_both_ways(&space, &[]);
    assert_eq!(fs::read(&shown).unwrap(), before);

    fs::remove_file(space.path(&format!(".srnerf/results/{}/{key}.json", &key[..2]))).unwrap();
    run_both_ways(&space, &["up"]);

    let blob = space.path(&format!(".srnerf/cas/{}/{blob}", &blob[..2]));
    fs::set_permissions(&blob, fs::Permissions::from_mode(0o644)).unwrap();
    let mut bytes = fs::read(&blob).unwrap();
    bytes[200] ^= 1;
    fs::write(&blob, bytes).unwrap();
    run_both_ways(&space, &["up"]);
    assert_eq!(fs::read(&shown).unwrap(), before);
}
