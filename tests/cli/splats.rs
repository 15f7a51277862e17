//! A field as splats: what they lose beside it, and what is in the files. Whether other libraries
//! take them is tried by `tests/exports`.

use std::fs;

use crate::space::Space;

/// A drawn scene with a field, whose held-out photos are twice as large as those it was fitted to.
const FITTED: &str = r#"(
    name: "fitted",
    stages: {
        "scene": Scene(source: Procedural(views: 9, size: (96, 72), samples: 1), downscale: 2, holdout: 3),
        "fit": Fit(images: "scene.train", steps: 150, samples: 16384),
    },
)"#;

const SHORT: [&str; 5] = [
    "--scale=2",
    "--most=6000",
    "--steps=60",
    "--degree=1",
    "--json",
];

fn fitted() -> Space {
    let space = Space::new();
    fs::write(space.path("fitted.ron"), FITTED).unwrap();
    space.ok(&["run", "fitted.ron"]);
    space
}

#[test]
fn splats_lose_little_beside_their_field() {
    let space = fitted();
    let said = space.ok(&[&["export", "splat", "fitted", "-o", "a.ply"], &SHORT[..]].concat());
    let told = said.json();
    let number = |name: &str| told[name].as_f64().unwrap();
    // The store knows the photos that the scene holds out.
    assert_eq!([number("views"), number("held_out")], [6.0, 3.0], "{told}");
    assert!(number("loss") < 1.5, "{told}");
    assert!(number("psnr_to_field") > 24.0, "{told}");
    let count = told["splats"].as_u64().unwrap();
    assert!((1000..=6000).contains(&count), "{told}");

    let bytes = fs::read(space.path("a.ply")).unwrap();
    let header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n");
    assert!(bytes.starts_with(header.as_bytes()));
    let end = bytes
        .windows(11)
        .position(|part| part == b"end_header\n")
        .unwrap()
        + 11;
    assert_eq!((bytes.len() - end) as u64, count * 26 * 4);
}

#[test]
fn every_format_has_the_same_splats_by_any_number_of_threads() {
    let space = fitted();
    let field = "out/fitted/fit/field";
    let few = ["--most=500", "--steps=8", "--json"];
    let export = |file: &str, threads: &str| {
        let threads = [("RAYON_NUM_THREADS", threads.to_owned())];
        let said = space.say_with(
            &threads,
            &[&["export", "splat", field, "-o", file], &few[..]].concat(),
        );
        assert_eq!(said.code, 0, "{}", said.err);
        said.json()["splats"].as_u64().unwrap()
    };
    let count = export("a.ply", "1");
    assert_eq!(count, export("b.ply", "3"));
    let read = |file: &str| fs::read(space.path(file)).unwrap();
    assert_eq!(read("a.ply"), read("b.ply"));

    assert_eq!(count, export("a.glb", "2"));
    assert!(read("a.glb").starts_with(b"glTF\x02\0\0\0"));
    assert_eq!(count, export("a.usda", "2"));
    let text = String::from_utf8(read("a.usda")).unwrap();
    assert!(text.starts_with("#usda 1.0\n") && text.contains("def ParticleField3DGaussianSplat"));
    let opacities = text
        .lines()
        .find(|line| line.contains("float[] opacities"))
        .unwrap();
    assert_eq!(opacities.split(", ").count() as u64, count);
}

#[test]
fn what_cannot_be_written_is_refused() {
    let space = Space::new();
    let said = space.say(&["export", "splat", "-o", "a.spz"]);
    assert_eq!(said.code, 2);
    assert!(
        said.err.contains("a.spz ends in no format of splats"),
        "{}",
        said.err
    );
    let said = space.say(&["export", "splat", "nothing", "-o", "a.ply"]);
    assert!(
        said.code != 0 && !space.path("a.ply").exists(),
        "{}",
        said.err
    );
}
