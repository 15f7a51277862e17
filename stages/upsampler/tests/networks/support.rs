//! The golden files, and files made of them.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use compute::{Array, Device};
use formats::FileBytes;
use safetensors::{Dtype, SafeTensors};
use upsampler::{Upsampler, UpsamplerError, UpsamplerSource};

/// The path of a golden file.
pub fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(name)
}

/// What a golden file holds.
pub fn bytes(name: &str) -> Vec<u8> {
    fs::read(golden(name)).unwrap()
}

/// The network of a golden file.
pub fn load(name: &str, device: &Device) -> Upsampler {
    Upsampler::load(&UpsamplerSource::File(golden(name)), device).unwrap()
}

/// The image that PyTorch was given, and what it made of it.
pub fn asked(name: &str, device: &Device) -> [Array; 2] {
    let (stem, _) = name.rsplit_once('.').unwrap();
    let bytes = bytes(&format!("{stem}.expected.safetensors"));
    let file = SafeTensors::deserialize(&bytes).unwrap();
    ["sample", "expected"].map(|name| {
        let view = file.tensor(name).unwrap();
        let values = view
            .data()
            .as_chunks()
            .0
            .iter()
            .map(|b| f32::from_le_bytes(*b))
            .collect();
        device.array(view.shape(), values)
    })
}

/// Tensors by name: number format, shape and little-endian bytes.
pub type Stored = BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)>;

/// The tensors of a golden file.
pub fn tensors(name: &str) -> Stored {
    let bytes = bytes(name);
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let stored = |(name, view): (String, safetensors::tensor::TensorView)| {
        (
            name,
            (view.dtype(), view.shape().to_vec(), view.data().to_vec()),
        )
    };
    file.tensors().into_iter().map(stored).collect()
}

/// What is said of a safetensors file of these tensors, which is refused.
pub fn refused(tensors: &Stored) -> String {
    let views = tensors.iter().map(|(name, (dtype, shape, data))| {
        (
            name.as_str(),
            safetensors::tensor::TensorView::new(*dtype, shape.clone(), data).unwrap(),
        )
    });
    let bytes = safetensors::serialize(views, None).unwrap();
    said(Upsampler::from_safetensors(
        FileBytes::in_memory("w.safetensors", bytes),
        &Device::cpu(),
    ))
}

/// What is said of an ncnn pair, which is refused.
pub fn pair_refused(param: &str, bin: &[u8]) -> String {
    let graph = FileBytes::in_memory("w.param", param.as_bytes().to_vec());
    said(Upsampler::from_ncnn(
        &graph,
        &FileBytes::in_memory("w.bin", bin.to_vec()),
        &Device::cpu(),
    ))
}

pub fn said(result: Result<Upsampler, UpsamplerError>) -> String {
    result.err().expect("a refusal").to_string()
}

/// The largest difference between two arrays.
#[track_caller]
pub fn furthest(a: &Array, b: &Array) -> f32 {
    assert_eq!(a.shape(), b.shape());
    a.to_vec()
        .iter()
        .zip(b.to_vec())
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

/// A picture of waves and edges, [1, 3, h, w].
pub fn picture(h: usize, w: usize, device: &Device) -> Array {
    let value = |i: usize| {
        let c = i / (h * w);
        let y = i / w % h;
        let x = i % w;
        let wave = ((x * (c + 2)) as f32 * 0.13).sin() * ((y + 3 * c) as f32 * 0.21).cos();
        0.5 + 0.35 * wave
            + if (x / 9 + y / 7).is_multiple_of(2) {
                0.12
            } else {
                -0.12
            }
    };
    device.array(&[1, 3, h, w], (0..3 * h * w).map(value).collect())
}
