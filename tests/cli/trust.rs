//! Results that can be trusted: computed again, and traced back from a bare file.

use std::fs;

use serde_json::json;

use crate::space::Space;

#[test]
fn a_result_that_comes_out_the_same_again_is_said_to_do_so() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let store = space.files(".srnerf");
    let said = space.ok(&["verify", "tiny.ron"]);
    assert_eq!(
        said.out,
        "scene  the same bits\nup     the same bits\nagain  the same bits\n"
    );
    assert_eq!(
        space.ok(&["verify", "up", "tiny.ron", "--json"]).json(),
        json!({"stages": [
        {"stage": "up", "state": "the_same_bits", "differences": {}}]})
    );
    // To verify leaves the store alone.
    space.assert_files(".srnerf", &store);
}

/// A store whose result of `up` is another picture, as if the code had changed without its version.
#[test]
fn a_result_that_comes_out_otherwise_is_measured() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let old = ["inspect", "up", "tiny.ron", "--json"];
    let other = ["--set", "up.filter=Lanczos", "--store", "other"];
    space.ok(&[&["run", "tiny.ron"], &other[..]].concat());
    let victim = space.ok(&old).json();
    let mut forged = space.ok(&[&old[..], &other].concat()).json();
    forged["key"] = victim["key"].clone();
    for file in forged["outputs"]["images"]["files"].as_array().unwrap() {
        let blob = file["blob"].as_str().unwrap();
        let to = space.path(&format!(".srnerf/cas/{}", &blob[..2]));
        fs::create_dir_all(&to).unwrap();
        fs::copy(
            space.path(&format!("other/cas/{}/{blob}", &blob[..2])),
            to.join(blob),
        )
        .unwrap();
    }
    let key = victim["key"].as_str().unwrap();
    let record = space.path(&format!(".srnerf/results/{}/{key}.json", &key[..2]));
    fs::write(record, forged.to_string()).unwrap();
    let said = space.say(&["verify", "up", "tiny.ron"]);
    assert_eq!(said.code, 5, "{}", said.err);
    assert!(
        said.out.starts_with("up  ") && said.out.contains("differs"),
        "{}",
        said.out
    );
    let line = said
        .out
        .lines()
        .find(|line| line.contains("images/view_001.exr R "))
        .unwrap();
    assert!(
        line.contains(" of 768 values, at most ")
            && line.contains(" ulp, ")
            && line.ends_with(" dB"),
        "{line}"
    );
    assert!(
        said.err
            .contains("1 of 1 stages did not come to the same result again"),
        "{}",
        said.err
    );
}

#[test]
fn what_has_no_result_cannot_be_verified() {
    let space = Space::new();
    let said = space.say(&["verify", "up", "tiny.ron"]);
    assert_eq!(said.code, 2);
    assert!(said.out.contains("up  no result"), "{}", said.out);
}

/// Copied anywhere, without a store: the file itself tells.
#[test]
fn a_bare_file_says_where_it_comes_from() {
    let space = Space::new();
    space.ok(&["run", "tiny.ron"]);
    let key = space.ok(&["inspect", "up", "tiny.ron", "--json"]).json()["key"].clone();
    for name in ["view_001.exr", "transforms.json"] {
        let copy = space
            .path("copy")
            .with_extension(name.rsplit('.').next().unwrap());
        fs::write(
            &copy,
            fs::read(space.path(&format!("out/tiny/up/images/{name}"))).unwrap(),
        )
        .unwrap();
        let copy = copy.to_str().unwrap();
        let told = space
            .ok(&["whence", copy, "--store", "nowhere", "--json"])
            .json();
        let provenance = &told["provenance"];
        assert_eq!(
            (
                &provenance["stage"],
                &provenance["kind"],
                &provenance["key"]
            ),
            (&json!("up"), &json!("Interpolate"), &key)
        );
        assert_eq!(provenance["params"]["factor"], 2.0);
        assert_eq!(told["in_store"], json!([]));
        let known = space.ok(&["whence", copy, "--json"]).json();
        assert_eq!(
            known["in_store"],
            json!([{"key": key, "stage": "up", "file": format!("images/{name}")}])
        );
        assert_eq!(known["inputs_from"], json!({"images": "scene.train"}));
        let text = space.ok(&["whence", copy]).out;
        assert!(
            text.contains("up: Interpolate version ")
                && text.contains("params.factor           2.0\n"),
            "{text}"
        );
    }
}

#[test]
fn a_file_of_nobody_is_said_to_be_so() {
    let space = Space::new();
    fs::write(space.path("note.json"), "{}").unwrap();
    let said = space.say(&["whence", "note.json"]);
    assert_eq!(said.code, 5);
    assert!(
        said.err.contains("nothing says where note.json comes from"),
        "{}",
        said.err
    );
    assert_eq!(space.say(&["whence", "gone.exr"]).code, 2);
}
