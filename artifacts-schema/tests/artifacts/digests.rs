//! Semantic digests see every number and name, and nothing else.

use std::collections::BTreeSet;
use std::path::Path;

use artifacts_schema::{Artifact, ArtifactKind, Digest, Provenance, semantic_digest};
use tempfile::tempdir;

use crate::samples;

fn digests(root: &Path) -> Vec<Digest> {
    ArtifactKind::ALL
        .iter()
        .map(|&kind| semantic_digest(kind, &root.join(kind.name())).unwrap())
        .collect()
}

#[test]
fn the_digest_of_a_folder_is_that_of_what_was_written() {
    let root = tempdir().unwrap();
    samples::write_all(root.path(), &samples::provenance()).unwrap();
    let expected = [
        samples::images().semantic_digest(),
        samples::latents().semantic_digest(),
        samples::residuals().semantic_digest(),
        samples::lora().semantic_digest(),
        samples::field().semantic_digest(),
        samples::metrics().semantic_digest(),
        samples::log().semantic_digest(),
        samples::figures().semantic_digest(),
        samples::film().semantic_digest(),
    ];
    assert_eq!(digests(root.path()), expected);
    assert_eq!(
        expected.iter().collect::<BTreeSet<_>>().len(),
        9,
        "each kind has a domain of its own"
    );
}

/// Stored results are found by these digests: if this test fails, raise the version in the digests'
/// domain.
#[test]
fn digests_are_the_same_as_ever() {
    let root = tempdir().unwrap();
    samples::write_all(root.path(), &samples::provenance()).unwrap();
    let short: Vec<String> = digests(root.path())
        .iter()
        .map(|digest| digest.to_string()[..16].to_owned())
        .collect();
    assert_eq!(short, GOLDEN);
}

const GOLDEN: [&str; 9] = [
    "5e8d3e9e78202a2e",
    "7518a0ad463c15ee",
    "26a2b6b932710eec",
    "eac8131e94d004ad",
    "5f3a1857f7da053f",
    "afec2aca9b31acfc",
    "a55f08426fd6db3b",
    "0fe80f0c7c44ad21",
    "c5d18ae7ee851717",
];

#[test]
fn provenance_does_not_count() {
    let one = tempdir().unwrap();
    let other = tempdir().unwrap();
    samples::write_all(one.path(), &samples::provenance()).unwrap();
    samples::write_all(other.path(), &Provenance::default()).unwrap();
    assert_eq!(digests(one.path()), digests(other.path()));
}

#[test]
fn the_layout_of_json_does_not_count() {
    let root = tempdir().unwrap();
    samples::write_all(root.path(), &samples::provenance()).unwrap();
    let before = digests(root.path());
    let transforms = root.path().join("images/transforms.json");
    let text = std::fs::read_to_string(&transforms).unwrap();
    let reordered = text
        .replacen("{", "{\"comment\": [ ],\n\n", 1)
        .replace("\"w\": 5", "\"w\"  :5")
        .replace("0.1,", "1e-1,");
    assert_ne!(text, reordered);
    std::fs::write(&transforms, reordered).unwrap();
    std::fs::write(
        root.path().join("log/log.jsonl"),
        "{\"step\":1,\"loss\":1e-1}\n{ \"warning\":\"é\",\"loss\":1e-9, \"step\":2}",
    )
    .unwrap();
    assert_eq!(digests(root.path()), before);
}

/// Each change gives a digest that differs from the original's and from every other's.
fn all_count<A: Artifact>(original: impl Fn() -> A, changes: &[fn(&mut A)]) {
    let mut seen = BTreeSet::from([original().semantic_digest()]);
    for (index, change) in changes.iter().enumerate() {
        let mut changed = original();
        change(&mut changed);
        assert!(
            seen.insert(changed.semantic_digest()),
            "change {index} of {} does not count",
            A::KIND
        );
    }
}

#[test]
fn everything_in_images_counts() {
    all_count(
        samples::images,
        &[
            |images| images.views[0].pixels.rgb[59] += 1e-6,
            |images| images.views[0].pixels.alpha = None,
            |images| images.views[0].pixels.alpha = images.views[0].depth.take(),
            |images| images.views[0].depth.as_mut().unwrap()[19] = 0.0,
            |images| images.views[1].name = "view_002".to_owned(),
            |images| images.views[1].camera.cx += 1e-15,
            |images| images.views[1].camera.cy += 1e-15,
            |images| images.views[1].camera.fl_x += 1e-15,
            |images| images.views[1].camera.fl_y += 1e-15,
            |images| images.views[1].camera.near += 1e-15,
            |images| images.views[1].camera.far += 1e-12,
            |images| images.views[1].camera.distortion.k1 = 1e-15,
            |images| images.views[1].camera.distortion.k2 = 1e-15,
            |images| images.views[1].camera.distortion.k3 = 1e-15,
            |images| images.views[1].camera.distortion.p1 = 1e-15,
            |images| images.views[1].camera.distortion.p2 = 1e-15,
            |images| images.views[1].camera.camera_to_world.w_axis.z += 1e-15,
            |images| (images.views[0].camera.width, images.views[0].camera.height) = (4, 5),
            |images| images.bounds[1][2] = 0.0,
            |images| drop(images.views.pop()),
        ],
    );
}

#[test]
fn everything_in_tensors_counts() {
    all_count(
        samples::latents,
        &[
            |latents| latents.vae.push('2'),
            |latents| latents.scaling_factor = 0.18215,
            |latents| latents.views[0].size = [4, 5],
            |latents| latents.views[0].tensor.shape = vec![4, 2, 1],
            |latents| latents.views[0].tensor.values[7] = 0.0,
            |latents| latents.views[0].camera.near = 0.2,
            |latents| latents.views[0].name = "view_002".to_owned(),
            |latents| latents.bounds[0][0] = -2.0,
        ],
    );
    all_count(
        samples::lora,
        &[
            |lora| lora.rank = 3,
            |lora| lora.alpha = 3.0,
            |lora| lora.camera = std::mem::take(&mut lora.tensors),
            |lora| drop(lora.camera.pop_first()),
            |lora| lora.tensors.first_entry().unwrap().get_mut().values[0] = 1.0,
        ],
    );
    all_count(
        samples::field,
        &[
            |field| field.config["levels"] = 8.into(),
            |field| field.bounds[0][0] = -2.0,
            |field| field.tensors.first_entry().unwrap().get_mut().values[0] = 1.0,
            |field| drop(field.tensors.pop_first()),
        ],
    );
}

#[test]
fn everything_in_texts_and_figures_counts() {
    all_count(
        samples::metrics,
        &[
            |metrics| {
                *metrics
                    .rows
                    .get_mut("vsd")
                    .unwrap()
                    .mean
                    .get_mut("psnr")
                    .unwrap() += 4e-15
            },
            |metrics| metrics.rows.get_mut("vsd").unwrap().views.clear(),
            |metrics| drop(metrics.rows.pop_first()),
            |metrics| metrics.definitions.clear(),
        ],
    );
    all_count(
        samples::log,
        &[
            |log| log.lines.reverse(),
            |log| drop(log.lines.pop()),
            |log| log.lines[0]["step"] = 2.into(),
        ],
    );
    all_count(
        samples::figures,
        &[
            |figures| figures.images.first_entry().unwrap().get_mut().rgb8[35] += 1,
            |figures| {
                drop(
                    figures
                        .images
                        .insert("other".to_owned(), figures.images["compare"].clone()),
                )
            },
            |figures| {
                let picture = figures.images.pop_first().unwrap().1;
                figures.images.insert("renamed".to_owned(), picture);
            },
        ],
    );
}

#[test]
fn zero_has_no_sign_and_nan_no_payload() {
    let mut field = samples::field();
    let before = field.semantic_digest();
    let values = &mut field.tensors.get_mut("table").unwrap().values;
    (values[0], values[1]) = (0.0, f32::from_bits(0xffc0_1234));
    assert_eq!(field.semantic_digest(), before);
}

#[test]
fn the_order_of_views_does_not_count() {
    let mut images = samples::images();
    images.views.reverse();
    assert_eq!(
        images.semantic_digest(),
        samples::images().semantic_digest()
    );
}

#[test]
fn a_digest_is_its_text() {
    let digest = samples::images().semantic_digest();
    let json = serde_json::to_string(&digest).unwrap();
    assert_eq!(json, format!("\"{digest}\""));
    assert_eq!(serde_json::from_str::<Digest>(&json).unwrap(), digest);
    assert_eq!(
        "abc".parse::<Digest>().unwrap_err().to_string(),
        "`abc` is not a digest: expected 64 hexadecimal digits"
    );
}
