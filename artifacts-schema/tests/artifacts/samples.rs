//! One small artifact of each kind.
#![allow(dead_code, clippy::unwrap_used)] // The example uses only some of them; a test may panic.

use std::collections::BTreeMap;
use std::path::Path;

use artifacts_schema::{
    Artifact, Field, Figures, Film, ImageSet, LatentView, Latents, Log, Lora, Metrics, Picture,
    Provenance, Residuals, Row, SchemaError, View,
};
use formats::{Camera, Distortion, Pixels, Tensor, rows};
use serde_json::json;

/// Numbers that no short text holds, the same on every machine.
pub fn numbers(count: usize) -> Vec<f32> {
    (0..count)
        .map(|index| ((index * 37 % 101) as f32 - 50.5) / 33.0)
        .collect()
}

pub fn provenance() -> Provenance {
    Provenance {
        program: "srnerf-dag 0.1.0".to_owned(),
        stage: "i3ds[0].render".to_owned(),
        kind: "Render".to_owned(),
        version: "1".to_owned(),
        key: "5f".repeat(32),
        device: String::new(),
        params: json!({ "steps": 2000, "rate": 0.01, "note": "é 🦀" }),
        inputs: BTreeMap::from([("field".to_owned(), "a0".repeat(32))]),
    }
}

/// Stands at (1, 2, 3), turned by 30 degrees about y, its principal point off the centre.
pub fn camera() -> Camera {
    let sin = 0.5;
    let cos = 3f64.sqrt() / 2.0;
    Camera {
        width: 5,
        height: 4,
        fl_x: 6.1,
        fl_y: 1.0 / 0.17,
        cx: 2.4,
        cy: 2.1,
        distortion: Distortion::default(),
        camera_to_world: rows::matrix(&[
            [cos, 0.0, sin, 1.0],
            [0.0, 1.0, 0.0, 2.0],
            [-sin, 0.0, cos, 3.0],
            [0.0, 0.0, 0.0, 1.0],
        ]),
        near: 0.1,
        far: 1e3 / 3.0,
    }
}

pub const BOUNDS: [[f64; 3]; 2] = [[-1.0, -0.1, -1.0 / 3.0], [1.0, 0.3, 2e-7]];

pub fn images() -> ImageSet {
    let full = View {
        name: "view_000".to_owned(),
        camera: camera(),
        pixels: Pixels::new(numbers(60), Some(numbers(20))),
        depth: Some([numbers(19), vec![f32::INFINITY]].concat()),
        mask: None,
    };
    let plain = View {
        name: "view_001".to_owned(),
        pixels: Pixels::opaque(numbers(60)),
        depth: None,
        ..full.clone()
    };
    ImageSet {
        views: vec![full, plain],
        bounds: BOUNDS,
        to_source: None,
    }
}

pub fn latents() -> Latents {
    let tensor = Tensor {
        shape: vec![4, 1, 2],
        values: numbers(8),
    };
    let view = |name: &str| LatentView {
        name: name.to_owned(),
        size: [5, 4],
        camera: camera(),
        tensor: tensor.clone(),
    };
    Latents {
        vae: "tiny-x4".to_owned(),
        scaling_factor: 0.08333,
        views: vec![view("view_000"), view("view_001")],
        bounds: BOUNDS,
    }
}

pub fn residuals() -> Residuals {
    Residuals(latents())
}

pub fn lora() -> Lora {
    // A layer of the embedded prior, so that diffusers can load it.
    let module = "unet.down_blocks.1.attentions.0.transformer_blocks.0.attn1.to_k";
    let down = Tensor {
        shape: vec![2, 32],
        values: numbers(64),
    };
    let up = Tensor {
        shape: vec![96, 2],
        values: numbers(192),
    };
    let embedding = Tensor {
        shape: vec![3, 16],
        values: numbers(48),
    };
    Lora {
        rank: 2,
        alpha: 4.0,
        tensors: [
            (format!("{module}.lora_A.weight"), down),
            (format!("{module}.lora_B.weight"), up),
        ]
        .into(),
        camera: BTreeMap::from([("linear_1.weight".to_owned(), embedding)]),
    }
}

pub fn field() -> Field {
    let table = Tensor {
        shape: vec![3, 2],
        values: vec![-0.0, f32::NAN, f32::MIN_POSITIVE, 1.0, -2.5, 1e-42],
    };
    Field {
        config: json!({ "levels": 16, "features": 2, "growth": 1.4472692012786865 }),
        tensors: BTreeMap::from([
            ("table".to_owned(), table),
            (
                "scalar".to_owned(),
                Tensor {
                    shape: vec![],
                    values: vec![1.5],
                },
            ),
        ]),
        bounds: BOUNDS,
    }
}

pub fn metrics() -> Metrics {
    let scores = BTreeMap::from([("psnr".to_owned(), 27.1 + 1e-15), ("ssim".to_owned(), 1.0)]);
    let row = Row {
        mean: scores.clone(),
        views: BTreeMap::from([("view_000".to_owned(), scores)]),
    };
    Metrics {
        rows: BTreeMap::from([("vsd".to_owned(), row.clone()), ("bicubic".to_owned(), row)]),
        definitions: BTreeMap::from([(
            "psnr".to_owned(),
            "10 log10(1 / MSE), sRGB, higher is better".to_owned(),
        )]),
        absent: BTreeMap::new(),
    }
}

pub fn log() -> Log {
    Log {
        lines: vec![
            json!({ "step": 1, "loss": 0.1 }),
            json!({ "step": 2, "loss": 1e-9, "warning": "é" }),
        ],
    }
}

pub fn figures() -> Figures {
    let picture = Picture {
        width: 4,
        height: 3,
        rgb8: (0..36).map(|byte| byte * 7).collect(),
        legend: BTreeMap::new(),
    };
    Figures {
        images: BTreeMap::from([("compare".to_owned(), picture)]),
    }
}

pub fn film() -> Film {
    Film {
        clips: BTreeMap::from([("color".to_owned(), b"GIF89a and so on;".to_vec())]),
    }
}

/// Writes one artifact of each kind, each into the folder of its kind's name.
pub fn write_all(root: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
    fn write<A: Artifact>(
        artifact: A,
        root: &Path,
        provenance: &Provenance,
    ) -> Result<(), SchemaError> {
        artifact.write(&root.join(A::KIND.name()), provenance)
    }
    write(images(), root, provenance)?;
    write(latents(), root, provenance)?;
    write(residuals(), root, provenance)?;
    write(lora(), root, provenance)?;
    write(field(), root, provenance)?;
    write(metrics(), root, provenance)?;
    write(log(), root, provenance)?;
    write(figures(), root, provenance)?;
    write(film(), root, provenance)
}

/// Every file under a folder, sorted by path.
pub fn files(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(root).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        match path.is_dir() {
            true => files.extend(
                self::files(&path)
                    .into_iter()
                    .map(|(rest, bytes)| (format!("{name}/{rest}"), bytes)),
            ),
            false => drop(files.insert(name, std::fs::read(&path).unwrap())),
        }
    }
    files
}
