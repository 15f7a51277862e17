//! What `Fit` learns about photos beside the field, and what later stages make of it.

use std::fs;

use artifacts_schema::{Artifact, ImageSet};
use serde_json::Value;

use crate::space::Space;

const PIPELINE: &str = r#"(
    name: "corrections",
    stages: {
        "scene": Scene(source: Procedural(views: 6, size: (32, 24), samples: 1), downscale: 2, holdout: 6),
        "fit": Fit(images: "scene.train", steps: 6),
        "learnt": Fit(images: "scene.train", steps: 6, exposure: (), poses: (start: 2, rate: 0.01)),
        "render": Render(field: "learnt", cameras: "learnt.photos"),
        "evaluate": Evaluate(
            field: "learnt", baseline: "fit", truth: "scene.test", low: "scene.test_low", train: "learnt.photos",
            exposed: true, posed: true, figures: 0,
        ),
    },
)"#;

fn ran() -> Space {
    let space = Space::new();
    fs::write(space.path("corrections.ron"), PIPELINE).unwrap();
    space.ok(&["run", "corrections.ron"]);
    space
}

fn images(space: &Space, path: &str) -> ImageSet {
    ImageSet::read(&space.path(&format!("out/corrections/{path}"))).unwrap()
}

#[test]
fn refined_cameras_and_exposures_are_artifacts_that_later_stages_read() {
    let space = ran();
    let given = images(&space, "scene/train");
    let photos = images(&space, "learnt/photos");
    let renders = images(&space, "render/images");
    let of = |images: &ImageSet| {
        images
            .views
            .iter()
            .map(|view| view.camera)
            .collect::<Vec<_>>()
    };
    assert!(of(&photos) != of(&given), "cameras moved");
    assert_eq!(of(&renders), of(&photos));
    let log = fs::read_to_string(space.path("out/corrections/learnt/exposures/log.jsonl")).unwrap();
    let lines: Vec<Value> = log
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines.len(), photos.views.len());
    let product: f64 = lines
        .iter()
        .map(|line| line["gain"][0].as_f64().unwrap())
        .product();
    assert!(
        (product - 1.0).abs() < 1e-4,
        "the mean exposure is the identity: {product}"
    );
    let without = space.path("out/corrections/fit/photos");
    assert!(!without.exists(), "nothing of it where it is not asked for");
}

#[test]
fn held_out_views_are_measured_as_they_are_at_their_own_exposure_and_from_refined_cameras() {
    let space = ran();
    let metrics = fs::read(space.path("out/corrections/evaluate/metrics/metrics.json")).unwrap();
    let metrics: Value = serde_json::from_slice(&metrics).unwrap();
    let mean = &metrics["rows"]["sr_nerf"]["mean"];
    let value = |name: &str| mean[name].as_f64().unwrap();
    assert!(value("psnr_hr_exposed") > value("psnr_hr"));
    // After six steps no field shows where a photo was taken: it is measured, and differs.
    assert_ne!(value("psnr_hr_posed"), value("psnr_hr"));
    assert!(
        metrics["rows"]["bicubic"]["mean"]["psnr_hr_posed"].is_null(),
        "an enlarged picture has one camera"
    );
    assert!(
        metrics["definitions"]["psnr_hr_exposed"]
            .as_str()
            .unwrap()
            .contains("gain")
    );
}

#[test]
fn what_makes_no_sense_is_refused_by_its_name() {
    let space = Space::new();
    fs::write(space.path("corrections.ron"), PIPELINE).unwrap();
    for (set, words) in [
        ("learnt.exposure.pull=-1", "exposure.pull"),
        ("learnt.poses.rate=2", "poses.rate"),
    ] {
        let said = space.say(&["plan", "corrections.ron", "--set", set]);
        assert!(said.code == 2 && said.err.contains(words), "{}", said.err);
    }
}
