//! `model check` and `model pull`: the files of a model, checked, and got from a hub.

use std::fs;
use std::path::Path;

use crate::hub::Hub;
use crate::model_run::tiny_x4;
use crate::space::Space;

#[test]
fn a_check_tells_parts_and_digests() {
    let space = Space::new();
    let said = space.say(&["model", "check", tiny_x4().to_str().unwrap(), "--json"]);
    assert_eq!(said.code, 0, "{}", said.err);
    let parts = said.json()["parts"].clone();
    let files = said.json()["files"].clone();
    let names: Vec<&str> = parts
        .as_array()
        .unwrap()
        .iter()
        .map(|part| part["part"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["unet", "vae", "text_encoder"]);
    assert_eq!(
        parts[0]["types"]
            .as_object()
            .unwrap()
            .keys()
            .collect::<Vec<_>>(),
        ["F16"]
    );
    assert_eq!(files.as_array().unwrap().len(), 13);
    assert!(
        files
            .as_array()
            .unwrap()
            .iter()
            .all(|file| file["sha256"].as_str().unwrap().len() == 64)
    );
}

#[test]
fn a_model_is_pulled_piece_by_piece_and_checked() {
    let space = Space::new();
    let hub = Hub::new(&tiny_x4());
    let pull = |hub: &Hub| {
        let home = space.path("home");
        let set = [
            ("HF_ENDPOINT", hub.url()),
            ("HF_HOME", home.to_str().unwrap().to_owned()),
        ];
        space.say_with(&set, &["model", "pull", "owner/tiny", "--json"])
    };
    hub.cut_off("unet/diffusion_pytorch_model.safetensors");
    let said = pull(&hub);
    assert!(
        said.code == 2
            && said
                .err
                .contains("unet/diffusion_pytorch_model.safetensors"),
        "{}",
        said.err
    );
    hub.serve_all();
    let said = pull(&hub);
    assert_eq!(said.code, 0, "{}", said.err);
    assert!(
        hub.resumed("unet/diffusion_pytorch_model.safetensors"),
        "the file was got from its beginning again"
    );
    let folder = said.json()["folder"].as_str().unwrap().to_owned();
    let checked = space.say(&["model", "check", &folder, "--json"]);
    assert_eq!(checked.code, 0, "{}", checked.err);
    // What is there is not got again, but it is checked again.
    let requests = hub.downloads();
    assert_eq!((pull(&hub).code, hub.downloads()), (0, requests));
    let weights = Path::new(&folder)
        .join("vae/diffusion_pytorch_model.safetensors")
        .canonicalize()
        .unwrap();
    let mut bytes = fs::read(&weights).unwrap();
    bytes[1000] ^= 1;
    fs::write(&weights, bytes).unwrap();
    let said = pull(&hub);
    assert!(
        said.code == 2 && said.err.contains("digest"),
        "{}",
        said.err
    );
    assert_eq!(pull(&hub).code, 0);
}

#[test]
fn a_name_that_is_none_is_refused_without_a_request() {
    let space = Space::new();
    for name in [
        "tiny",
        "a/b/c",
        "../tiny",
        "owner/a b",
        "owner/",
        "owner/..%2f",
    ] {
        let said = space.say(&["model", "pull", name]);
        assert!(
            said.code == 2 && said.err.contains("is no name of a model"),
            "{name}: {}",
            said.err
        );
    }
}
