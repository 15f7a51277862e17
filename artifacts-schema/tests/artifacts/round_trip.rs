//! Every artifact comes back from disk as it was.

use std::fmt::Debug;

use artifacts_schema::{Artifact, ImageSet, SchemaError, StoredImages, View};
use formats::{Distortion, rows};
use glam::DVec4;
use proptest::prelude::*;
use tempfile::tempdir;

use crate::samples;

fn round_trip<A: Artifact>(artifact: &A) -> A {
    let folder = tempdir().unwrap();
    artifact
        .write(folder.path(), &samples::provenance())
        .unwrap();
    A::read(folder.path()).unwrap()
}

fn comes_back<A: Artifact + PartialEq + Debug>(artifact: A) {
    assert_eq!(round_trip(&artifact), artifact);
}

#[test]
fn every_kind_comes_back() {
    comes_back(samples::images());
    comes_back(samples::latents());
    comes_back(samples::residuals());
    comes_back(samples::lora());
    comes_back(samples::metrics());
    comes_back(samples::log());
    comes_back(samples::figures());
    comes_back(samples::film());
}

/// Why a metric is missing is told and is content; where nothing is missing, nothing is told.
#[test]
fn what_metrics_lack_comes_back_with_its_reason() {
    let whole = samples::metrics();
    let mut lacking = whole.clone();
    let reason = ("niqe".to_owned(), "the pictures are too small".to_owned());
    lacking.absent.insert("vsd".into(), [reason].into());
    assert_ne!(lacking.semantic_digest(), whole.semantic_digest());
    comes_back(lacking);
}

#[test]
fn tensors_come_back_bit_by_bit_with_nan_and_negative_zero() {
    let field = samples::field();
    let read = round_trip(&field);
    let bits = |values: &[f32]| {
        values
            .iter()
            .map(|value| value.to_bits())
            .collect::<Vec<_>>()
    };
    assert_eq!(
        bits(&read.tensors["table"].values),
        bits(&field.tensors["table"].values)
    );
    assert_eq!(read.tensors["scalar"], field.tensors["scalar"]);
    assert_eq!((read.config, read.bounds), (field.config, field.bounds));
}

/// The cameras of an image set are read alone, with whether there is alpha.
#[test]
fn cameras_come_back_without_their_images() {
    let images = samples::images();
    let folder = tempdir().unwrap();
    let read = |images: &ImageSet| {
        images.write(folder.path(), &samples::provenance()).unwrap();
        StoredImages::open(folder.path()).unwrap()
    };
    let views = images.views.iter();
    let cameras: Vec<_> = views.map(|view| (view.name.clone(), view.camera)).collect();
    let stored = read(&images);
    assert_eq!(stored.cameras(), cameras);
    assert_eq!(
        (stored.bounds, stored.to_source),
        (images.bounds, images.to_source)
    );
    assert!(stored.has_alpha().unwrap());
    let mut opaque = images;
    opaque.views[0].pixels.alpha = None;
    assert!(!read(&opaque).has_alpha().unwrap());
}

#[test]
fn pixels_come_back_bit_by_bit_with_nan_and_negative_zero() {
    let mut images = samples::images();
    images.views[0].pixels.rgb[..4].copy_from_slice(&[f32::NAN, -0.0, f32::NEG_INFINITY, 1e-42]);
    let bits = |view: &View| {
        view.pixels
            .rgb
            .iter()
            .map(|value| value.to_bits())
            .collect::<Vec<_>>()
    };
    assert_eq!(bits(&round_trip(&images).views[0]), bits(&images.views[0]));
}

#[test]
fn views_come_back_sorted_by_name() {
    let mut images = samples::images();
    images.views.reverse();
    assert_eq!(round_trip(&images), samples::images());
}

#[test]
fn a_legend_comes_back_and_counts() {
    let mut figures = samples::figures();
    let legend = &mut figures.images.get_mut("compare").unwrap().legend;
    legend.extend([
        ("Range".to_owned(), "0.5 to 3".to_owned()),
        ("Unit".to_owned(), "m²".to_owned()),
    ]);
    assert_ne!(
        figures.semantic_digest(),
        samples::figures().semantic_digest()
    );
    comes_back(figures);
}

#[test]
fn a_bent_lens_comes_back_shared_by_all_views_or_of_one_alone() {
    let bent = Distortion {
        k1: 0.1,
        k2: -1.0 / 3.0,
        p2: 1e-9,
        ..Distortion::default()
    };
    let mut images = samples::images();
    images.views[1].camera.distortion = bent;
    assert_eq!(round_trip(&images), images);
    images.views[0].camera.distortion = bent;
    assert_eq!(round_trip(&images), images);
}

#[test]
fn cameras_of_different_sizes_come_back() {
    let mut images = samples::images();
    let camera = &mut images.views[1].camera;
    camera.width = 4;
    camera.height = 5;
    camera.fl_x = 0.1;
    comes_back(images);
}

#[test]
fn an_empty_image_set_comes_back() {
    comes_back(ImageSet {
        views: Vec::new(),
        bounds: samples::BOUNDS,
        to_source: None,
    });
}

#[test]
fn masks_fisheyes_and_the_way_back_to_the_source_come_back() {
    let mut images = samples::images();
    images.views[0].mask = Some((0..20).map(|i| i % 3 != 0).collect());
    images.views[1].camera.distortion.fisheye = true;
    images.views[1].camera.distortion.k4 = 0.25;
    let row = |i: usize| std::array::from_fn(|j| (4 * i + j) as f64 / 3.0);
    images.to_source = Some(std::array::from_fn(row));
    let plain = samples::images().semantic_digest();
    assert_ne!(images.semantic_digest(), plain);
    comes_back(images);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 4))]

    #[test]
    fn any_camera_comes_back_exactly(numbers in prop::array::uniform24(prop::num::f64::NORMAL)) {
        let mut images = samples::images();
        images.views.truncate(1);
        let camera = &mut images.views[0].camera;
        camera.fl_x = numbers[0];
        camera.fl_y = numbers[1];
        camera.cx = numbers[2];
        camera.cy = numbers[3];
        camera.near = numbers[4];
        camera.far = numbers[5];
        // Upper triangular, its diagonal moderate: any such matrix can be inverted.
        camera.camera_to_world = rows::matrix(&[
            [0.3, numbers[6], numbers[7], numbers[8]],
            [0.0, 1.7, numbers[9], numbers[10]],
            [0.0, 0.0, -0.9, numbers[11]],
            [0.0, 0.0, 0.0, 1.0],
        ]);
        images.bounds = [[numbers[12], numbers[13], numbers[14]], [numbers[15], numbers[16], numbers[17]]];
        prop_assert_eq!(round_trip(&images), images);
    }
}

/// The message of a refused write, and that nothing was written.
fn refused<A: Artifact>(artifact: &A) -> String {
    let folder = tempdir().unwrap();
    let error = artifact
        .write(folder.path(), &samples::provenance())
        .unwrap_err();
    assert!(matches!(error, SchemaError::Content { .. }), "{error}");
    assert!(samples::files(folder.path()).is_empty(), "{error}");
    error.to_string()
}

#[test]
fn what_has_no_form_on_disk_is_refused_by_name() {
    let mut images = samples::images();
    images.views[1].name = "view_000".to_owned();
    assert_eq!(
        refused(&images),
        "name \"view_000\": is there twice; each view needs its own"
    );

    let mut images = samples::images();
    images.views[0].name = "../elsewhere".to_owned();
    assert!(refused(&images).starts_with("name \"../elsewhere\": cannot name a file"));

    let mut images = samples::images();
    images.views[1].depth = Some(vec![1.0; 19]);
    assert_eq!(
        refused(&images),
        "view \"view_001\": depth has 19 values; expected 20"
    );

    let mut images = samples::images();
    images.views[0].camera.far = f64::INFINITY;
    assert_eq!(
        refused(&images),
        "view \"view_000\": its camera holds inf; all must be finite"
    );

    let mut images = samples::images();
    images.views[0].camera.width = 0;
    assert_eq!(
        refused(&images),
        "view \"view_000\": is 0x4; expected 1 to 65536 pixels each way"
    );

    let mut images = samples::images();
    images.views[0].camera.camera_to_world.y_axis = DVec4::ZERO;
    assert_eq!(
        refused(&images),
        "view \"view_000\": its camera-to-world matrix cannot be inverted"
    );

    let mut images = samples::images();
    images.to_source = Some([[f64::NAN; 4]; 4]);
    assert_eq!(refused(&images), "to_source: holds NaN; all must be finite");

    let mut metrics = samples::metrics();
    metrics
        .rows
        .get_mut("vsd")
        .unwrap()
        .mean
        .insert("niqe".to_owned(), f64::NAN);
    assert!(refused(&metrics).starts_with("row \"vsd\", mean: niqe: is NaN"));

    let mut lora = samples::lora();
    lora.tensors.pop_last();
    assert_eq!(
        refused(&lora),
        "tensors: lora_A and lora_B do not come in pairs"
    );

    let mut latents = samples::latents();
    latents.views[0].tensor.shape = vec![4, 2, 2];
    assert_eq!(
        refused(&latents),
        "tensor \"view_000\": 8 values do not fill the shape [4, 2, 2]"
    );
}
