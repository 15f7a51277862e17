//! Files `transforms.json` broken in every way: refused by name and field, or read.

use std::path::Path;

use proptest::prelude::*;
use scene::Transforms;
use serde_json::{Value, json};

use super::written;
use crate::common::{any_damage, transforms, words};

#[test]
fn what_is_wrong_is_named_by_file_and_field() {
    let fault = |change: &dyn Fn(&mut Value), expected: &[&str]| {
        let folder = written("transforms.json", change);
        let error =
            transforms(folder.path(), &Transforms::default()).expect_err("the scene is spoilt");
        let words = words(error, folder.path());
        for part in [&["SCENE/"], expected].concat() {
            assert!(words.contains(part), "{part} is not in: {words}");
        }
    };
    let frame = "transforms.json: frame \"images/1.png\": ";
    fault(
        &|page| page["frames"][1]["transform_matrix"][0][0] = json!("one"),
        &[frame, "transform_matrix holds \"one\"; expected a number"],
    );
    fault(
        &|page| page["frames"][1]["fl_x"] = json!("long"),
        &[frame, "fl_x is \"long\"; expected a number"],
    );
    fault(
        &|page| page["frames"] = json!([]),
        &["transforms.json: frames: is empty"],
    );
    fault(
        &|page| *page = json!({}),
        &["has no `frames`; expected a list of frames"],
    );
    fault(
        &|page| page["frames"][1]["fl_x"] = json!(-3.0),
        &[frame, "focal lengths -3"],
    );
    fault(
        &|page| page["frames"][1]["transform_matrix"][0][1] = json!(0.3),
        &[frame, "transform_matrix has columns"],
    );
    fault(
        &|page| page["frames"][1]["camera_model"] = json!("EQUIRECTANGULAR"),
        &[frame, "EQUIRECTANGULAR", "undistort"],
    );
    fault(&|page| page["k4"] = json!(0.1), &["k4, k5 or k6 is set"]);
    fault(&|page| page["k1"] = json!(-9.0), &["folds the image over"]);
    fault(
        &|page| page["w"] = json!(1e300),
        &["w is not a whole number of pixels"],
    );
    fault(
        &|page| page["w"] = json!(18),
        &["images/0.png: the photo: is 24x18, but its camera is for 18x18"],
    );
    fault(&|page| page["aabb_scale"] = json!(-1), &["the scene box"]);
    fault(
        &|page| page["train_filenames"] = json!(["other"]),
        &["leaves no photo to train on"],
    );
    fault(
        &|page| drop(page.as_object_mut().unwrap().remove("fl_x")),
        &["has neither fl_x nor camera_angle_x nor x_fov"],
    );
    let gone =
        |page: &mut Value| (0..3).for_each(|i| page["frames"][i]["file_path"] = json!("no.png"));
    fault(&gone, &["SCENE/no.png: the photo is missing"]);
    let nowhere = transforms(Path::new("no/such/scene"), &Transforms::default())
        .unwrap_err()
        .to_string();
    assert!(
        nowhere.contains("transforms.json: the cameras' file is missing; point to a folder"),
        "{nowhere}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: ProptestConfig::default().cases / 4, failure_persistence: None, ..ProptestConfig::default() })]
    /// Whatever is in the file, it is read or refused by name.
    #[test]
    fn no_damage_is_more_than_an_error(damages in prop::collection::vec(any_damage(), 1..4)) {
        let folder = written("transforms.json", |_| {});
        let path = folder.path().join("transforms.json");
        let whole = std::fs::read(&path).unwrap();
        let bytes = damages.iter().fold(whole, |bytes, damage| damage.to(&bytes));
        std::fs::write(&path, bytes).unwrap();
        match transforms(folder.path(), &Transforms::default()) {
            Ok(scene) => prop_assert!(scene.bounds.as_flattened().iter().all(|side| side.is_finite())),
            Err(error) => prop_assert!(words(error, folder.path()).contains("SCENE")),
        }
    }
}
