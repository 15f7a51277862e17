//! Files with the upscaler's names and any shapes: a configuration or one error, and never a panic.

use std::collections::BTreeMap;

use formats::{TensorView, Values};
use proptest::prelude::*;

use super::*;
use crate::config::{TextConfig, UnetConfig, VaeConfig};

const ROWS: &str = include_str!("../../tests/golden/single_file.json");

/// A file of these tensors, all of whose numbers are 0.
fn file(shapes: &BTreeMap<String, Vec<usize>>) -> TensorFile {
    let zeros = [0.0; 1 << 8];
    let view = |shape: &'_ Vec<usize>| {
        let count = shape.iter().product::<usize>();
        Values::F32(&zeros[..count])
    };
    let views = shapes.iter().map(|(name, shape)| {
        (
            name.as_str(),
            TensorView {
                shape,
                values: view(shape),
            },
        )
    });
    let bytes = formats::tensor_file::to_bytes(&views.collect(), &BTreeMap::new()).unwrap();
    TensorFile::new(FileBytes::in_memory("x4.safetensors", bytes)).unwrap()
}

fn names() -> Vec<String> {
    let rows: Vec<(String, Vec<usize>, serde_json::Value)> = serde_json::from_str(ROWS).unwrap();
    rows.into_iter().map(|(name, ..)| name).collect()
}

/// Reads all that a single file says of itself.
fn read(tensors: TensorFile) {
    let _ = family::check(&tensors);
    let path = PathBuf::from("x4.safetensors");
    let file = SingleFile { path, tensors };
    let config = |name: &str| file.find(name).ok().flatten();
    let _ = config("unet/config.json").map(|file| UnetConfig::read(&file).is_ok());
    let _ = config("vae/config.json").map(|file| VaeConfig::read(&file).is_ok());
    let _ = config("text_encoder/config.json").map(|file| TextConfig::read(&file).is_ok());
}

proptest! {
    #[test]
    fn any_names_of_it_in_any_shapes_never_panic(
        kept in 0.0..1.0f64, picks in prop::collection::vec((0.0..1.0f64, prop::collection::vec(0..4usize, 0..5)), 940)
    ) {
        let all = names();
        prop_assert!(all.len() <= picks.len());
        let chosen = all.into_iter().zip(picks).filter(|(_, (pick, _))| *pick < kept.sqrt());
        read(file(&chosen.map(|(name, (_, shape))| (name, shape)).collect()));
    }
}
