//! Models from folders and from memory.

use super::*;

fn copy_embedded(folder: &Path) {
    for (name, bytes) in EMBEDDED {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}

#[test]
fn a_folder_and_its_embedded_copy_have_one_digest_and_every_file_counts() {
    let folder = tempfile::tempdir().unwrap();
    copy_embedded(folder.path());
    let source = ModelSource::Folder(folder.path().to_owned());
    let digest = ModelSource::Embedded.digest().unwrap();
    assert_eq!(source.digest().unwrap(), digest);
    let plain = folder
        .path()
        .join("vae/diffusion_pytorch_model.safetensors");
    std::fs::rename(
        &plain,
        folder
            .path()
            .join("vae/diffusion_pytorch_model.fp16.safetensors"),
    )
    .unwrap();
    assert_eq!(source.digest().unwrap(), digest);
    std::fs::write(folder.path().join("model_index.json"), "{}").unwrap();
    assert_ne!(source.digest().unwrap(), digest);
}

#[test]
fn what_is_missing_or_pickled_is_named_with_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    copy_embedded(folder.path());
    let source = ModelSource::Folder(folder.path().to_owned());
    std::fs::remove_file(folder.path().join("text_encoder/model.safetensors")).unwrap();
    let missing = source.digest().unwrap_err().to_string();
    assert!(
        missing.contains("text_encoder/model.safetensors: is missing"),
        "{missing}"
    );
    std::fs::write(folder.path().join("text_encoder/pytorch_model.bin"), "x").unwrap();
    let pickled = source.digest().unwrap_err().to_string();
    assert!(
        pickled.contains("pytorch_model.bin: is a pickle")
            && pickled.contains("safe_serialization"),
        "{pickled}"
    );
}
