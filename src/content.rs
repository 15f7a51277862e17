//! What is in an EXR, safetensors or JSON file, whoever wrote it: arrays with their ranges, and facts. Knows nothing of stages.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use exr::prelude::{AttributeValue, FlatSamples, read_all_flat_layers_from_file};
use safetensors::{Dtype, SafeTensors};
use serde_json::{Value, json};

use crate::progress::figure;

/// Files above this size are not read whole.
const LARGEST: u64 = 16 << 30;

/// What is in a file.
#[derive(Debug, Default)]
pub struct Content {
    /// Its arrays.
    pub arrays: Vec<Array>,
    /// What else it says.
    pub facts: BTreeMap<String, Value>,
}

/// An array in a file.
#[derive(Debug)]
pub struct Array {
    name: String,
    shape: Vec<usize>,
    kind: String,
    /// Least, mean and greatest value, of floating-point arrays.
    range: Option<[f64; 3]>,
}

impl Array {
    /// Its line in a table.
    pub fn row(&self) -> Vec<String> {
        let shape = self.shape.iter().map(ToString::to_string).collect::<Vec<_>>().join("x");
        let range = self.range.map_or([String::new(), String::new(), String::new()], |range| range.map(figure));
        [self.name.clone(), shape, self.kind.clone()].into_iter().chain(range).collect()
    }

    fn json(&self) -> Value {
        let [least, mean, most] = self.range.map_or([None; 3], |range| range.map(Some));
        json!({"name": self.name, "shape": self.shape, "type": self.kind, "least": least, "mean": mean, "most": most})
    }
}

/// How to read a file.
type Reader = fn(&Path) -> Result<Content, String>;

/// How to read a file with this extension.
fn reader(path: &Path) -> Option<Reader> {
    match path.extension()?.to_str()? {
        "exr" => Some(read_exr),
        "safetensors" | "latent" => Some(read_safetensors),
        "json" => Some(read_json),
        _ => None,
    }
}

impl Content {
    /// Whether a path is that of a file which can be read, going by its extension.
    pub fn can_read(path: &Path) -> bool {
        reader(path).is_some()
    }

    /// Reads a file by its extension.
    pub fn read(path: &Path) -> Result<Self, String> {
        reader(path).ok_or("a file of an unknown type")?(path)
    }

    /// All of it as JSON.
    pub fn json(&self) -> Value {
        json!({"arrays": self.arrays.iter().map(Array::json).collect::<Vec<_>>(), "facts": self.facts})
    }
}

fn read_exr(path: &Path) -> Result<Content, String> {
    let image = read_all_flat_layers_from_file(path).map_err(|error| error.to_string())?;
    let mut content = Content::default();
    for layer in &image.layer_data {
        for channel in &layer.channel_data.list {
            let kind = match channel.sample_data {
                FlatSamples::F16(_) => "half",
                FlatSamples::F32(_) => "float",
                FlatSamples::U32(_) => "uint",
            };
            content.arrays.push(Array {
                name: channel.name.to_string(),
                shape: vec![layer.size.height(), layer.size.width()],
                kind: kind.into(),
                range: range(channel.sample_data.values_as_f32()),
            });
        }
        let camera = [
            ("worldToCamera", layer.attributes.world_to_camera),
            ("worldToNDC", layer.attributes.world_to_normalized_device),
        ];
        let camera =
            camera.into_iter().filter_map(|(name, matrix)| Some((name, json!(matrix?.chunks(4).collect::<Vec<_>>()))));
        let planes = [("near", layer.attributes.near_clip_plane), ("far", layer.attributes.far_clip_plane)];
        let planes = planes.into_iter().filter_map(|(name, depth)| Some((name, json!(depth?))));
        content.facts.extend(camera.chain(planes).map(|(name, value)| (name.to_owned(), value)));
        for (name, value) in &layer.attributes.other {
            if let AttributeValue::Text(text) = value {
                content.facts.insert(name.to_string(), text_value(&text.to_string()));
            }
        }
    }
    Ok(content)
}

fn read_safetensors(path: &Path) -> Result<Content, String> {
    let bytes = read_whole(path)?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| error.to_string())?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(|error| error.to_string())?;
    let mut content = Content::default();
    for (name, tensor) in tensors.tensors() {
        let floats = |bytes: &[u8]| {
            bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect::<Vec<_>>()
        };
        let range = (tensor.dtype() == Dtype::F32).then(|| range(floats(tensor.data()).into_iter())).flatten();
        content.arrays.push(Array {
            name,
            shape: tensor.shape().to_vec(),
            kind: format!("{:?}", tensor.dtype()),
            range,
        });
    }
    content.arrays.sort_by(|a, b| a.name.cmp(&b.name));
    let metadata = header.metadata().iter().flatten();
    content.facts = metadata.map(|(name, text)| (name.clone(), text_value(text))).collect();
    Ok(content)
}

fn read_json(path: &Path) -> Result<Content, String> {
    let value: Value = serde_json::from_slice(&read_whole(path)?).map_err(|error| error.to_string())?;
    let facts = match value {
        Value::Object(fields) => fields.into_iter().collect(),
        other => BTreeMap::from([("value".to_owned(), other)]),
    };
    Ok(Content { arrays: Vec::new(), facts })
}

fn read_whole(path: &Path) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(LARGEST).read_to_end(&mut bytes));
    read.map(|_| bytes).map_err(|error| error.to_string())
}

/// A text that holds JSON as what it holds.
fn text_value(text: &str) -> Value {
    match serde_json::from_str(text) {
        Ok(value @ Value::Object(_)) => value,
        _ => Value::String(text.to_owned()),
    }
}

fn range(values: impl Iterator<Item = f32>) -> Option<[f64; 3]> {
    let (mut least, mut sum, mut most, mut count) = (f64::INFINITY, 0.0, f64::NEG_INFINITY, 0u64);
    for value in values.map(f64::from) {
        (least, sum, most, count) = (least.min(value), sum + value, most.max(value), count + 1);
    }
    (count > 0).then(|| [least, sum / count as f64, most])
}
