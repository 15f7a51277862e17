//! Files with any bytes in them: one error or a result, and never a panic.

use compute::Device;
use diffusion::config::{TextConfig, UnetConfig, VaeConfig};
use formats::{FileBytes, TensorFile};
use proptest::prelude::*;

/// Two tensors and metadata.
fn tensors() -> Vec<u8> {
    let header = r#"{"__metadata__":{"format":"pt"},"a.weight":{"dtype":"F32","shape":[2,2],"data_offsets":[0,16]},
        "b":{"dtype":"F16","shape":[3],"data_offsets":[16,22]},"ids":{"dtype":"I64","shape":[1],"data_offsets":[22,30]}}"#;
    [
        &(header.len() as u64).to_le_bytes()[..],
        header.as_bytes(),
        &[0; 30],
    ]
    .concat()
}

const UNET: &str = include_str!("../../models/tiny-x4/unet/config.json");
const VAE: &str = include_str!("../../models/tiny-x4/vae/config.json");
const TEXT: &str = include_str!("../../models/tiny-x4/text_encoder/config.json");

/// Bytes overwritten, and the end cut off.
fn damaged(
    bytes: &[u8],
    changes: &[(prop::sample::Index, u8)],
    keep: prop::sample::Index,
) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for (at, value) in changes {
        let at = at.index(bytes.len());
        bytes[at] = *value;
    }
    bytes.truncate(keep.index(bytes.len() * 8) + 1);
    bytes
}

fn read_all(bytes: Vec<u8>) {
    let Ok(file) = TensorFile::new(FileBytes::in_memory("w.safetensors", bytes)) else {
        return;
    };
    for name in file.names() {
        let _ = diffusion::array(&file, name, &Device::cpu());
        let _ = file.whole(name);
    }
}

fn read_configs(text: &[u8]) {
    let file = FileBytes::in_memory("config.json", text.to_vec());
    let _ = (
        UnetConfig::read(&file),
        VaeConfig::read(&file),
        TextConfig::read(&file),
    );
}

/// A value in place of one field, of any type and size.
fn any_value() -> impl Strategy<Value = serde_json::Value> {
    use serde_json::{Value, json};
    prop_oneof![
        any::<i64>().prop_map(Value::from),
        any::<f64>().prop_map(|v| json!(v)),
        "[a-zA-Z0-9]{0,12}".prop_map(Value::from),
        prop::collection::vec(0u64..70_000, 0..5).prop_map(|v| json!(v)),
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
    ]
}

proptest! {
    #[test]
    fn damaged_tensor_files_never_panic(changes in prop::collection::vec(any::<(prop::sample::Index, u8)>(), 0..6), keep: prop::sample::Index) {
        read_all(damaged(&tensors(), &changes, keep));
    }

    #[test]
    fn damaged_configurations_never_panic(
        which in 0..3usize, changes in prop::collection::vec(any::<(prop::sample::Index, u8)>(), 0..4), keep: prop::sample::Index
    ) {
        read_configs(&damaged([UNET, VAE, TEXT][which].as_bytes(), &changes, keep));
    }

    #[test]
    fn any_value_of_a_field_is_taken_or_refused(which in 0..3usize, field: prop::sample::Index, value in any_value()) {
        let mut config: serde_json::Map<String, serde_json::Value> = serde_json::from_str([UNET, VAE, TEXT][which]).unwrap();
        let name = config.keys().nth(field.index(config.len())).unwrap().clone();
        config.insert(name, value);
        read_configs(serde_json::Value::Object(config).to_string().as_bytes());
    }
}

#[test]
fn the_undamaged_files_are_read() {
    let file = TensorFile::new(FileBytes::in_memory("w.safetensors", tensors())).unwrap();
    assert_eq!(file.names().collect::<Vec<_>>(), ["a.weight", "b", "ids"]);
    assert_eq!(
        diffusion::array(&file, "a.weight", &Device::cpu())
            .unwrap()
            .shape(),
        [2, 2]
    );
    assert!(UnetConfig::read(&FileBytes::in_memory("config.json", UNET.into())).is_ok());
}
