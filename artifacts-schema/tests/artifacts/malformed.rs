//! Broken files give an error that names them: never a panic.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use artifacts_schema::{Artifact, ArtifactKind, View, semantic_digest};
use formats::{Camera, Pixels};
use proptest::prelude::*;
use proptest::sample::Index;
use tempfile::{TempDir, tempdir};

use crate::samples;

fn samples_on_disk() -> TempDir {
    let root = tempdir().unwrap();
    samples::write_all(root.path(), &samples::provenance()).unwrap();
    root
}

/// The message of reading `kind` after one file of it was changed.
fn message(kind: ArtifactKind, file: &str, change: impl FnOnce(&mut Vec<u8>)) -> String {
    let root = samples_on_disk();
    let folder = root.path().join(kind.name());
    let path = folder.join(file);
    let mut bytes = std::fs::read(&path).unwrap();
    change(&mut bytes);
    std::fs::write(&path, bytes).unwrap();
    let message = semantic_digest(kind, &folder).unwrap_err().to_string();
    message.replace(&format!("{}/", folder.display()), "")
}

/// Replaces a text by another of the same length.
fn replace(bytes: &mut [u8], from: &str, to: &str) {
    assert_eq!(from.len(), to.len());
    let at = bytes
        .windows(from.len())
        .position(|window| window == from.as_bytes())
        .unwrap();
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
}

#[test]
fn a_missing_file_is_named() {
    let root = samples_on_disk();
    for (kind, file) in [
        (ArtifactKind::Images, "view_001.exr"),
        (ArtifactKind::Latents, "latents.safetensors"),
        (ArtifactKind::Lora, "camera_embedding.safetensors"),
        (ArtifactKind::Metrics, "metrics.json"),
    ] {
        let path = root.path().join(kind.name()).join(file);
        std::fs::remove_file(&path).unwrap();
        let message = semantic_digest(kind, &root.path().join(kind.name()))
            .unwrap_err()
            .to_string();
        assert!(
            message.starts_with(&format!("{}: No such file", path.display())),
            "{message}"
        );
    }
}

#[test]
fn broken_safetensors_are_named_with_the_place() {
    let latents =
        |change: fn(&mut Vec<u8>)| message(ArtifactKind::Latents, "latents.safetensors", change);
    assert!(latents(|bytes| bytes.truncate(5)).starts_with("latents.safetensors: header: "));
    assert!(latents(|bytes| bytes.truncate(100)).starts_with("latents.safetensors: header: "));
    assert!(latents(|bytes| bytes[..8].fill(0xff)).starts_with("latents.safetensors: header: "));
    assert!(
        latents(|bytes| bytes.truncate(bytes.len() - 1))
            .starts_with("latents.safetensors: header: ")
    );
    assert_eq!(
        latents(|bytes| replace(bytes, "\"F32\"", "\"I32\"")),
        "latents.safetensors: tensor \"view_000\": is I32; expected F32"
    );
    assert_eq!(
        latents(|bytes| replace(bytes, "\"view_001\":{\"data", "\"view_009\":{\"data")),
        "latents.safetensors: tensor \"view_001\": is missing"
    );
    assert_eq!(
        latents(|bytes| replace(bytes, "[4,1,2]", "[4,2]  ")),
        "latents.safetensors: tensor \"view_000\": has shape [4, 2]; expected [channels, height, width]"
    );
    assert_eq!(
        latents(|bytes| replace(bytes, "\"srnerf\"", "\"srperf\"")),
        "latents.safetensors: metadata \"srnerf\": is missing"
    );
    let message = latents(|bytes| replace(bytes, "scaling_factor", "sailing_factor"));
    assert!(
        message.starts_with(
            "latents.safetensors: metadata \"srnerf\": missing field `scaling_factor`"
        ),
        "{message}"
    );
}

#[test]
fn broken_images_are_named_with_the_place() {
    let view = |change: fn(&mut Vec<u8>)| message(ArtifactKind::Images, "view_001.exr", change);
    assert!(view(|bytes| bytes.truncate(3)).starts_with("view_001.exr: OpenEXR: "));
    assert!(view(|bytes| bytes.truncate(bytes.len() - 9)).starts_with("view_001.exr: OpenEXR: "));
    assert_eq!(
        view(|bytes| replace(bytes, "R\0\x02", "X\0\x02")),
        "view_001.exr: channels: are B, G, X; expected B, G, R, perhaps A, Z and mask"
    );
    assert_eq!(
        view(|bytes| replace(bytes, "B\0\x02", "B\0\x00")),
        "view_001.exr: channels: are not all 32-bit float without subsampling"
    );
    let wide = "view_001.exr: data window: is 2147483392x4; transforms.json says 5x4";
    let message = view(|bytes| widen(bytes, "dataWindow", 0x7fff_feff));
    assert!(
        message == wide || message.starts_with("view_001.exr: OpenEXR: "),
        "{message}"
    );
}

#[test]
fn an_absurd_size_is_refused_though_both_files_agree() {
    let root = samples_on_disk();
    let folder = root.path().join("images");
    let transforms = folder.join("transforms.json");
    let view = folder.join("view_000.exr");
    let text = std::fs::read_to_string(&transforms).unwrap();
    std::fs::write(&transforms, text.replace("\"w\": 5", "\"w\": 60000")).unwrap();
    let mut bytes = std::fs::read(&view).unwrap();
    widen(&mut bytes, "dataWindow", 59_999);
    widen(&mut bytes, "displayWindow", 59_999);
    std::fs::write(&view, bytes).unwrap();
    let message = semantic_digest(ArtifactKind::Images, &folder)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("view_000.exr: data window: is 60000x4, which"),
        "{message}"
    );
}

/// Sets the right end of a window attribute: name, type `box2i`, length, then left, top, right,
/// bottom.
fn widen(bytes: &mut [u8], window: &str, right: i32) {
    let start = [window.as_bytes(), b"\0box2i\0\x10\0\0\0"].concat();
    let at = bytes
        .windows(start.len())
        .position(|part| part == start)
        .unwrap()
        + start.len()
        + 8;
    bytes[at..at + 4].copy_from_slice(&right.to_le_bytes());
}

#[test]
fn broken_json_is_named_with_line_and_column() {
    let cut = message(ArtifactKind::Metrics, "metrics.json", |bytes| {
        bytes.truncate(30)
    });
    assert!(
        cut.starts_with("metrics.json: JSON: EOF while parsing")
            && cut.contains("at line 3 column"),
        "{cut}"
    );
    let line = message(ArtifactKind::Log, "log.jsonl", |bytes| {
        bytes.extend(b"[1]\n")
    });
    assert!(
        line.starts_with("log.jsonl: line 3: invalid type: sequence, expected a map"),
        "{line}"
    );
    let frame = message(ArtifactKind::Images, "transforms.json", |bytes| {
        replace(bytes, "\"view_000.exr\"", "\"../w_000.exr\"")
    });
    assert!(
        frame.starts_with("transforms.json: name \"../w_000\": cannot name a file"),
        "{frame}"
    );
    let width = |text: &str| {
        message(ArtifactKind::Images, "transforms.json", |bytes| {
            replace(bytes, "\"w\": 5\n}", &format!("\"w\":{text}}}"))
        })
    };
    let part = width("4.5");
    assert!(
        part.starts_with("transforms.json: JSON: is not a whole number of pixels"),
        "{part}"
    );
    let huge = width("1e5");
    assert!(huge.contains("is 100000x4; expected 1 to 65536"), "{huge}");
    let lens = message(ArtifactKind::Images, "transforms.json", |bytes| {
        replace(bytes, "\"fl_x\"", "\"fl_z\"")
    });
    assert_eq!(
        lens,
        "transforms.json: frame \"view_000.exr\": has no fl_x, nor is there one for all frames"
    );
}

#[test]
fn a_broken_png_is_named() {
    let cut = message(ArtifactKind::Figures, "compare.png", |bytes| {
        bytes.truncate(40)
    });
    assert!(cut.starts_with("compare.png: PNG: "), "{cut}");
    let text = message(ArtifactKind::Figures, "compare.png", |bytes| {
        *bytes = b"not a picture".to_vec()
    });
    assert!(text.starts_with("compare.png: PNG: "), "{text}");
}

/// The files of one artifact of each kind, with an image that is tall enough for several blocks.
static FILES: LazyLock<BTreeMap<String, Vec<u8>>> = LazyLock::new(|| {
    let root = samples_on_disk();
    let mut images = samples::images();
    let camera = Camera {
        width: 3,
        height: 40,
        ..samples::camera()
    };
    images.views.push(View {
        name: "view_002".to_owned(),
        camera,
        pixels: Pixels::opaque(samples::numbers(360)),
        depth: None,
        mask: None,
    });
    images
        .write(&root.path().join("images"), &samples::provenance())
        .unwrap();
    samples::files(root.path())
});

/// Cuts a file at a place, then sets some of its bytes.
fn damaged(bytes: &[u8], cut: Option<Index>, edits: &[(Index, u8)]) -> Vec<u8> {
    let mut bytes = bytes[..cut.map_or(bytes.len(), |cut| cut.index(bytes.len()))].to_vec();
    let length = bytes.len();
    for (place, byte) in edits.iter().filter(|_| length > 0) {
        bytes[place.index(length)] = *byte;
    }
    bytes
}

proptest! {
    /// A panic fails the test; an error, or content that happens to be sound, does not.
    /// `PROPTEST_CASES=100000` for more.
    #[test]
    fn no_damage_makes_a_reader_panic(
        file in any::<Index>(),
        cut in prop::option::weighted(0.2, any::<Index>()),
        edits in prop::collection::vec((any::<Index>(), any::<u8>()), 0..12),
    ) {
        let root = tempdir().unwrap();
        let name = FILES.keys().nth(file.index(FILES.len())).unwrap();
        let (kind, _) = name.split_once('/').unwrap();
        std::fs::create_dir(root.path().join(kind)).unwrap();
        for (other, bytes) in FILES.iter().filter(|(other, _)| other.starts_with(kind)) {
            std::fs::write(root.path().join(other), bytes).unwrap();
        }
        std::fs::write(root.path().join(name), damaged(&FILES[name], cut, &edits)).unwrap();
        let kind = ArtifactKind::ALL.into_iter().find(|known| known.name() == kind).unwrap();
        drop(semantic_digest(kind, &root.path().join(kind.name())));
    }
}
