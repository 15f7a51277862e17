//! Latent images that are read and written view by view are those of the whole set.

use std::fs;

use artifacts_schema::{
    Artifact, LatentHead, LatentHeads, LatentView, LatentWriter, Latents, SchemaError,
    StoredLatents, latent_stream, semantic_digest,
};
use tempfile::{TempDir, tempdir};

use crate::samples;

/// The BLAKE3 of the samples as a file: every version of the program leaves the same bytes.
const FILE: &str = "7456fb922541bd2d2dc7f0d5b3f92d6790f41b7151c0bef5450b29e728435507";

fn heads(latents: &Latents) -> LatentHeads {
    let head = |view: &LatentView| LatentHead {
        name: view.name.clone(),
        size: view.size,
        camera: view.camera,
        shape: view.tensor.shape.clone(),
    };
    LatentHeads {
        vae: latents.vae.clone(),
        scaling_factor: latents.scaling_factor,
        views: latents.views.iter().map(head).collect(),
        bounds: latents.bounds,
    }
}

fn writer(folder: &TempDir, heads: &LatentHeads) -> Result<LatentWriter, SchemaError> {
    LatentWriter::new(folder.path(), Latents::KIND, heads, &samples::provenance())
}

/// The samples on disk.
fn stored() -> (TempDir, StoredLatents) {
    let folder = tempdir().unwrap();
    let latents = samples::latents();
    latents
        .write(folder.path(), &samples::provenance())
        .unwrap();
    let stored = StoredLatents::open(folder.path(), Latents::KIND).unwrap();
    (folder, stored)
}

#[test]
fn views_that_come_one_by_one_leave_the_file_of_the_whole() {
    let latents = samples::latents();
    let folder = tempdir().unwrap();
    let mut writer = writer(&folder, &heads(&latents)).unwrap();
    for view in &latents.views {
        writer.add(&view.name, &view.tensor).unwrap();
    }
    writer.finish().unwrap();
    let stream = fs::read(folder.path().join("latents.safetensors")).unwrap();
    let (whole, _) = stored();
    let whole = fs::read(whole.path().join("latents.safetensors")).unwrap();
    assert_eq!(stream, whole);
    assert_eq!(blake3::hash(&whole).to_string(), FILE);
}

#[test]
fn views_that_are_read_one_by_one_are_those_of_the_whole() {
    let (folder, stored) = stored();
    let latents = samples::latents();
    assert_eq!(*stored.heads(), heads(&latents));
    let read: Result<Vec<LatentView>, _> = stored.views().collect();
    assert_eq!(read.unwrap(), latents.views);
    assert_eq!(stored.semantic_digest().unwrap(), latents.semantic_digest());
    assert_eq!(
        semantic_digest(Latents::KIND, folder.path()).unwrap(),
        latents.semantic_digest()
    );
    let sizes = latent_stream::sizes(&folder.path().join("latents.safetensors"));
    assert_eq!(sizes.unwrap(), [32, 32], "eight numbers each");
    let last = stored.only(&[1]);
    assert_eq!(
        (last.find("view_001"), last.find("view_000")),
        (Some(0), None)
    );
    assert_eq!(last.view(0).unwrap(), latents.views[1]);
}

#[test]
fn numbers_that_are_not_those_of_the_next_view_are_refused() {
    let latents = samples::latents();
    let heads = heads(&latents);
    let [first, last] = [0, 1].map(|at| latents.views[at].clone());
    let folder = tempdir().unwrap();
    let add = |name: &str, shape: &[usize]| {
        let mut tensor = first.tensor.clone();
        tensor.shape = shape.to_vec();
        let refused = writer(&folder, &heads).unwrap().add(name, &tensor);
        refused.unwrap_err().to_string()
    };
    assert_eq!(
        add("view_001", &[4, 1, 2]),
        "tensor \"view_001\": comes before \"view_000\""
    );
    assert_eq!(
        add("view_000", &[4, 2, 1]),
        "tensor \"view_000\": has shape [4, 2, 1]; expected [4, 1, 2]"
    );
    let mut full = writer(&folder, &heads).unwrap();
    full.add(&first.name, &first.tensor).unwrap();
    full.add(&last.name, &last.tensor).unwrap();
    let refused = full.add("view_002", &last.tensor).unwrap_err().to_string();
    assert_eq!(refused, "tensor \"view_002\": is one too many");
}

#[test]
fn a_file_that_lacks_a_view_is_none() {
    let latents = samples::latents();
    let folder = tempdir().unwrap();
    let mut half = writer(&folder, &heads(&latents)).unwrap();
    half.add("view_000", &latents.views[0].tensor).unwrap();
    assert_eq!(
        half.finish().unwrap_err().to_string(),
        "tensor \"view_001\": is missing"
    );
    let broken = StoredLatents::open(folder.path(), Latents::KIND).unwrap_err();
    assert!(broken.to_string().contains("latents.safetensors: header: "));
}

#[test]
fn heads_that_have_no_form_on_disk_are_refused_before_anything_is_written() {
    let folder = tempdir().unwrap();
    let mut twice = heads(&samples::latents());
    twice.views[1].name = "view_000".to_owned();
    let refused = writer(&folder, &twice).err().unwrap().to_string();
    assert!(refused.contains("is there twice"), "{refused}");
    assert!(fs::read_dir(folder.path()).unwrap().next().is_none());
}
