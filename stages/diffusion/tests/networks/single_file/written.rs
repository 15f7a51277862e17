//! A small x4 upscaler as files: in one, and as the folder that diffusers makes of it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use diffusion::ModelSource;
use serde_json::{Value, json};

use crate::support::{golden, numbers};

/// A tensor's values, which BF16 holds exactly.
#[derive(Clone)]
pub struct Tensor {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

/// The tensors of one file by name.
pub type Tensors = BTreeMap<String, Tensor>;

/// A tensor's name in the single file, its shape, and the folders and names that diffusers' own
/// conversion gives it: three where it splits it.
pub type Row = (String, Vec<usize>, Vec<(String, String)>);

/// What the script left.
pub fn rows() -> Vec<Row> {
    serde_json::from_slice(&std::fs::read(golden("single_file.json")).unwrap()).unwrap()
}

/// The numbers of the script's formula: gains around 1, all else small enough for the next layer.
pub fn single() -> Tensors {
    let tensor = |(stream, (name, shape, _)): (u64, Row)| {
        let (gain, offset) = match &shape[..] {
            [] | [_] => (0.1, f32::from(u8::from(name.ends_with("weight")))),
            [_, rest @ ..] => (
                (3.0 / rest.iter().product::<usize>() as f64).sqrt() as f32,
                0.0,
            ),
        };
        let scaled = numbers(stream, &shape).to_vec().into_iter();
        let values = scaled
            .map(|v| f32::from_bits((gain * v + offset).to_bits() & 0xFFFF_0000))
            .collect();
        (name, Tensor { shape, values })
    };
    (50_000..).zip(rows()).map(tensor).collect()
}

/// How a file stores numbers.
#[derive(Clone, Copy)]
pub enum Format {
    F32,
    Bf16,
}

impl Format {
    fn encode(self, values: &[f32]) -> Vec<u8> {
        let bits = values.iter().map(|v| v.to_bits());
        match self {
            Self::F32 => bits.flat_map(u32::to_le_bytes).collect(),
            Self::Bf16 => bits
                .flat_map(|bits| ((bits >> 16) as u16).to_le_bytes())
                .collect(),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::F32 => "F32",
            Self::Bf16 => "BF16",
        }
    }

    pub fn write(self, path: &Path, tensors: &Tensors) {
        let mut header = serde_json::Map::new();
        let mut data = Vec::new();
        for (name, tensor) in tensors {
            let start = data.len();
            data.extend(self.encode(&tensor.values));
            let entry = json!({ "dtype": self.name(), "shape": tensor.shape, "data_offsets": [start, data.len()] });
            header.insert(name.clone(), entry);
        }
        let header = Value::Object(header).to_string().into_bytes();
        let bytes = [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat();
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}

/// The files of tiny-x4.
fn tiny(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("models/tiny-x4")
        .join(name)
}

/// Writes `tensors` as a single file with the vocabulary of tiny-x4 beside it.
pub fn write_single(folder: &Path, tensors: &Tensors, format: Format) -> ModelSource {
    let path = folder.join("x4.safetensors");
    format.write(&path, tensors);
    for table in ["vocab.json", "merges.txt"] {
        std::fs::copy(tiny("tokenizer").join(table), folder.join(table)).unwrap();
    }
    ModelSource::at(&path)
}

/// The folder that diffusers' conversion makes of the single file.
pub fn write_folder(folder: &Path) -> ModelSource {
    let mut parts: BTreeMap<String, Tensors> = BTreeMap::new();
    let tensors = single();
    for (stored, _, places) in rows() {
        let tensor = &tensors[&stored];
        let count = tensor.values.len() / places.len().max(1);
        for (values, (part, name)) in tensor.values.chunks(count).zip(&places) {
            let mut shape = tensor.shape.clone();
            shape[0] /= places.len();
            let values = values.to_vec();
            let tensors = parts.entry(part.clone()).or_default();
            tensors.insert(name.clone(), Tensor { shape, values });
        }
    }
    for (part, tensors) in &parts {
        let stem = if part == "text_encoder" {
            "model"
        } else {
            "diffusion_pytorch_model"
        };
        let path = folder.join(part).join(format!("{stem}.safetensors"));
        Format::F32.write(&path, tensors);
    }
    write_descriptions(folder);
    ModelSource::at(folder)
}

/// The configurations of the script's networks, and the x4 upscaler's schedules.
fn write_descriptions(folder: &Path) {
    let plain = ["DownBlock2D", "UpBlock2D"];
    let crossed = ["CrossAttnDownBlock2D", "CrossAttnUpBlock2D"];
    let unet = json!({
        "in_channels": 7, "out_channels": 4, "block_out_channels": [32, 64, 64, 128], "layers_per_block": 2, "attention_head_dim": 8,
        "down_block_types": [plain[0], crossed[0], crossed[0], crossed[0]], "up_block_types": [crossed[1], crossed[1], crossed[1], plain[1]],
        "only_cross_attention": [true, true, true, false], "cross_attention_dim": 128, "num_class_embeds": 400,
        "use_linear_projection": true,
    });
    let vae = json!({
        "block_out_channels": [32, 64, 128], "layers_per_block": 2, "latent_channels": 4, "scaling_factor": 0.08333,
        "down_block_types": vec!["DownEncoderBlock2D"; 3], "up_block_types": vec!["UpDecoderBlock2D"; 3],
    });
    let text = json!({
        "vocab_size": 768, "hidden_size": 128, "intermediate_size": 512, "num_hidden_layers": 2, "num_attention_heads": 2,
        "max_position_embeddings": 24, "hidden_act": "gelu",
    });
    let tokens = json!({ "pad_token": "!" });
    let descriptions = [
        ("unet/config.json", unet),
        ("vae/config.json", vae),
        ("text_encoder/config.json", text),
        ("tokenizer/special_tokens_map.json", tokens),
    ];
    std::fs::create_dir_all(folder.join("tokenizer")).unwrap();
    for (name, config) in descriptions {
        std::fs::write(folder.join(name), config.to_string()).unwrap();
    }
    for name in [
        "tokenizer/vocab.json",
        "tokenizer/merges.txt",
        "scheduler/scheduler_config.json",
        "low_res_scheduler/scheduler_config.json",
        "model_index.json",
    ] {
        std::fs::create_dir_all(folder.join(name).parent().unwrap()).unwrap();
        std::fs::copy(tiny(name), folder.join(name)).unwrap();
    }
}
