//! What is in an EXR, safetensors or JSON file, whoever wrote it: arrays with their ranges, and
//! facts. Knows nothing of stages.

pub mod compare;
pub mod lineage;
mod tensors;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use artifacts_schema::Provenance;
use exr::prelude::{AttributeValue, FlatSamples, read_all_flat_layers_from_file};
use serde_json::{Value, json};

use crate::terminal::progress::figure;

/// Files above this size are not read whole.
const LARGEST: u64 = 16 << 30;

/// What is in a file.
#[derive(Debug, Default)]
pub struct Content {
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
        let shape = self
            .shape
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join("x");
        let range = self
            .range
            .map_or([String::new(), String::new(), String::new()], |range| {
                range.map(figure)
            });
        [self.name.clone(), shape, self.kind.clone()]
            .into_iter()
            .chain(range)
            .collect()
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
        "safetensors" | "latent" => Some(tensors::read),
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
        let camera = camera.into_iter().filter_map(|(name, matrix)| {
            Some((name, json!(matrix?.chunks(4).collect::<Vec<_>>())))
        });
        let planes = [
            ("near", layer.attributes.near_clip_plane),
            ("far", layer.attributes.far_clip_plane),
        ];
        let planes = planes
            .into_iter()
            .filter_map(|(name, depth)| Some((name, json!(depth?))));
        content.facts.extend(
            camera
                .chain(planes)
                .map(|(name, value)| (name.to_owned(), value)),
        );
        for (name, value) in &layer.attributes.other {
            if let AttributeValue::Text(text) = value {
                content
                    .facts
                    .insert(name.to_string(), text_value(&text.to_string()));
            }
        }
    }
    Ok(content)
}

fn read_json(path: &Path) -> Result<Content, String> {
    let value: Value =
        serde_json::from_slice(&read_whole(path)?).map_err(|error| error.to_string())?;
    let facts = match value {
        Value::Object(fields) => fields.into_iter().collect(),
        other => BTreeMap::from([("value".to_owned(), other)]),
    };
    Ok(Content {
        arrays: Vec::new(),
        facts,
    })
}

/// Numbers of one precision.
#[derive(Debug)]
pub enum Values {
    /// Of a picture's channel, or a tensor.
    Single(Vec<f32>),
    /// Of JSON.
    Double(Vec<f64>),
}

/// All numbers in a file, by the name of their channel, tensor or field.
pub fn values(path: &Path) -> Result<BTreeMap<String, Values>, String> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("exr") => {
            let image = read_all_flat_layers_from_file(path).map_err(|error| error.to_string())?;
            let channels = image
                .layer_data
                .iter()
                .flat_map(|layer| &layer.channel_data.list);
            Ok(channels
                .map(|channel| {
                    (
                        channel.name.to_string(),
                        Values::Single(channel.sample_data.values_as_f32().collect()),
                    )
                })
                .collect())
        }
        Some("safetensors" | "latent") => {
            let numbers = tensors::numbers(path)?.into_iter();
            Ok(numbers
                .map(|(name, values)| (name, Values::Single(values)))
                .collect())
        }
        Some("json") => {
            let value: Value =
                serde_json::from_slice(&read_whole(path)?).map_err(|error| error.to_string())?;
            let mut numbers = BTreeMap::new();
            collect_numbers("", &value, &mut numbers);
            Ok(numbers)
        }
        _ => Err("a file of an unknown type".into()),
    }
}

fn collect_numbers(path: &str, value: &Value, numbers: &mut BTreeMap<String, Values>) {
    let below = |name: &str| {
        if path.is_empty() {
            name.to_owned()
        } else {
            format!("{path}.{name}")
        }
    };
    match value {
        Value::Number(number) => {
            numbers.insert(
                path.to_owned(),
                Values::Double(number.as_f64().into_iter().collect()),
            );
        }
        Value::Object(fields) => fields
            .iter()
            .for_each(|(name, value)| collect_numbers(&below(name), value, numbers)),
        Value::Array(items) => {
            items
                .iter()
                .enumerate()
                .for_each(|(at, value)| collect_numbers(&below(&at.to_string()), value, numbers));
        }
        _ => {}
    }
}

/// Where a file of ours says that it comes from; `None` if it says nothing, or is none of ours.
pub fn provenance(path: &Path) -> Option<Provenance> {
    let facts = match path.extension()?.to_str()? {
        "png" => read_png_text(&read_whole(path).ok()?)?,
        _ => Content::read(path).ok()?.facts.into_iter().collect(),
    };
    find_provenance(&Value::Object(facts), 3)
}

/// The first object that says all that provenance does, at most `depth` objects down.
fn find_provenance(value: &Value, depth: usize) -> Option<Provenance> {
    let fields = value.as_object()?;
    if fields.contains_key("key") && fields.contains_key("kind") {
        return serde_json::from_value(value.clone()).ok();
    }
    fields
        .values()
        .filter(|_| depth > 0)
        .find_map(|value| find_provenance(value, depth - 1))
}

/// Our text chunk of a PNG.
fn read_png_text(bytes: &[u8]) -> Option<serde_json::Map<String, Value>> {
    let mut rest = bytes.strip_prefix(b"\x89PNG\r\n\x1a\n")?;
    loop {
        // A chunk is its length, its type, its data and a checksum. The length is whatever a file
        // says, so every step is checked.
        let (head, after) = rest.split_at_checked(8)?;
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let (data, after) = after.split_at_checked(length)?;
        if let Some(text) = data
            .strip_prefix(b"srnerf\0")
            .filter(|_| &head[4..] == b"tEXt")
        {
            return serde_json::from_slice(text).ok();
        }
        // Behind each chunk stand the four bytes of its checksum.
        rest = after.get(4..)?;
    }
}

fn read_whole(path: &Path) -> Result<Vec<u8>, String> {
    read_up_to(path, LARGEST)
}

fn read_up_to(path: &Path, largest: u64) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    // One byte more than there may be tells that there are more.
    let read = File::open(path).and_then(|file| file.take(largest + 1).read_to_end(&mut bytes));
    match read {
        Ok(read) if read as u64 > largest => Err(format!(
            "it is too large to be read: more than {largest} bytes"
        )),
        Ok(_) => Ok(bytes),
        Err(error) => Err(error.to_string()),
    }
}

/// A text that holds JSON as what it holds.
fn text_value(text: &str) -> Value {
    match serde_json::from_str(text) {
        // Only objects: a plain `1` or `true` is a text like any other.
        Ok(value @ Value::Object(_)) => value,
        _ => Value::String(text.to_owned()),
    }
}

fn range(values: impl Iterator<Item = f32>) -> Option<[f64; 3]> {
    let mut least = f64::INFINITY;
    let mut sum = 0.0;
    let mut most = f64::NEG_INFINITY;
    let mut count = 0u64;
    for value in values.map(f64::from) {
        // `min` and `max` pass over NaN, which so shows in the mean alone.
        least = least.min(value);
        sum += value;
        most = most.max(value);
        count += 1;
    }
    (count > 0).then(|| [least, sum / count as f64, most])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_too_large_is_not_cut() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file.json");
        std::fs::write(&path, "[1]").unwrap();
        assert_eq!(read_up_to(&path, 3).unwrap(), b"[1]");
        let error = read_up_to(&path, 2).unwrap_err();
        assert_eq!(error, "it is too large to be read: more than 2 bytes");
    }
}
