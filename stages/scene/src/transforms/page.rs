//! The JSON of `transforms.json` and its kin, as instant-ngp, nerfstudio and NeRF-synthetic write
//! it. Knows no photos.

use std::collections::BTreeSet;
use std::path::Path;

use formats::Bounds;
use formats::json::kind;
use serde_json::{Map, Value};

use super::lens::ForeignLens;
use crate::{SceneError, source_files};

/// More frames than any capture has.
const MOST_FRAMES: usize = 1 << 20;
/// What is told to whoever points to another JSON file.
const EXPECTED: &str = "expected a list of frames, each with `file_path` and `transform_matrix`, as nerfstudio, \
                        instant-ngp and NeRF-synthetic write it";
/// Fields of the whole file that are read, beside those of a lens.
const READ: &[&str] = &[
    "frames",
    "aabb",
    "aabb_scale",
    "scale",
    "offset",
    "train_filenames",
    "val_filenames",
    "test_filenames",
];
/// Fields of a frame that are read, beside those of a lens.
const READ_OF_FRAMES: &[&str] = &["file_path", "transform_matrix", "mask_path"];
/// Fields that say nothing about what a camera sees: not worth a word.
const QUIET: &[&str] = &[
    "sharpness",
    "rotation",
    "camera_label",
    "timestamp",
    "colmap_im_id",
    "applied_transform",
    "applied_scale",
    "srnerf",
];

/// What a `transforms.json` says, field by field.
#[derive(Debug)]
pub(crate) struct Page {
    pub(crate) frames: Vec<Frame>,
    /// What all frames share.
    pub(crate) lens: ForeignLens,
    /// The scene box, where the file is one of ours.
    pub(crate) aabb: Option<Bounds>,
    /// The side of instant-ngp's cube, and how it brings coordinates there: p * scale + offset.
    pub(crate) aabb_scale: Option<f64>,
    pub(crate) scale: Option<f64>,
    pub(crate) offset: Option<[f64; 3]>,
    /// nerfstudio's splits, by `file_path`.
    pub(crate) train_filenames: Vec<String>,
    pub(crate) val_filenames: Vec<String>,
    pub(crate) test_filenames: Vec<String>,
    /// Names of fields that are not used: of the file, and `frames.` of its frames.
    pub(crate) unused: Vec<String>,
}

/// One entry of `frames`: a photo and its camera.
#[derive(Debug)]
pub(crate) struct Frame {
    pub(crate) file_path: String,
    pub(crate) mask_path: Option<String>,
    /// What it says of its camera, or what is wrong with that.
    pub(crate) camera: Result<(ForeignLens, Vec<[f64; 4]>), String>,
}

impl Page {
    /// Reads a file. An error names its line and column, or its field.
    pub(crate) fn read(path: &Path) -> Result<Page, SceneError> {
        let bytes = source_files::read_file(path)?;
        let text = source_files::as_text(bytes)
            .map_err(|fault| SceneError::content(path, "the file", fault))?;
        let value =
            parse(&text).map_err(|(place, fault)| SceneError::content(path, place, fault))?;
        Self::of(&value).map_err(|(place, fault)| SceneError::content(path, place, fault))
    }

    fn of(value: &Value) -> Result<Page, (String, String)> {
        let whole = |fault: String| ("the file".to_owned(), fault);
        let fields = value
            .as_object()
            .ok_or_else(|| whole(format!("is {}; {EXPECTED}", kind(value))))?;
        let frames = match fields.get("frames") {
            Some(Value::Array(frames)) => frames,
            Some(other) => {
                return Err(("frames".into(), format!("is {}; {EXPECTED}", kind(other))));
            }
            None => return Err(whole(without_frames(fields))),
        };
        match frames.len() {
            // An empty scene would fail later, without the file's name.
            0 => return Err(("frames".into(), "is empty; expected one per photo".into())),
            // Frames are a foreign file's, and each asks for a look at the disk.
            count if count > MOST_FRAMES => {
                return Err(("frames".into(), format!("are {count}, too many")));
            }
            _ => {}
        }
        let frames: Vec<Frame> = frames
            .iter()
            .enumerate()
            .map(|(i, frame)| {
                Frame::of(frame).map_err(|fault| (format!("frame {i} (counted from 0)"), fault))
            })
            .collect::<Result<_, _>>()?;
        let at = |name: &'static str| move |fault| (name.to_owned(), fault);
        let list = |name: &'static str| texts(fields, name).map_err(at(name));
        let number_at = |name: &'static str| number(fields, name).map_err(whole);
        Ok(Page {
            lens: ForeignLens::of(fields).map_err(whole)?,
            aabb: array(fields, "aabb", vector).map_err(at("aabb"))?,
            aabb_scale: number_at("aabb_scale")?,
            scale: number_at("scale")?,
            offset: array_of_numbers(fields, "offset").map_err(at("offset"))?,
            train_filenames: list("train_filenames")?,
            val_filenames: list("val_filenames")?,
            test_filenames: list("test_filenames")?,
            unused: unused(fields),
            frames,
        })
    }

    /// Names of all fields that are read, and of those that are passed over without a word.
    pub(crate) fn known_fields() -> (Vec<&'static str>, Vec<&'static str>) {
        let read = [READ, READ_OF_FRAMES, &ForeignLens::fields()].concat();
        (read, QUIET.to_vec())
    }

    /// Whether the lens is given by its field of view alone, as in NeRF-synthetic.
    pub(crate) fn has_field_of_view_alone(&self) -> bool {
        let has_focal = |frame: &Frame| {
            let camera = frame.camera.as_ref();
            camera.is_ok_and(|(lens, _)| lens.lens.fl_x.is_some())
        };
        let focal = self.lens.lens.fl_x.is_some() || self.frames.iter().any(has_focal);
        self.lens.angles[0].is_some() && !focal
    }
}

impl Frame {
    fn of(value: &Value) -> Result<Frame, String> {
        let fields = value
            .as_object()
            .ok_or_else(|| format!("is {}; expected an object", kind(value)))?;
        let file_path = match fields.get("file_path") {
            Some(Value::String(path)) => path.clone(),
            Some(other) => return Err(format!("file_path is {}; expected a path", kind(other))),
            None => return Err("has no file_path".into()),
        };
        // A mask of another kind is passed over; some exporters write null.
        let mask_path = match fields.get("mask_path") {
            Some(Value::String(path)) => Some(path.clone()),
            _ => None,
        };
        // Kept as a fault: one bad frame is left out, and the others are read.
        let camera = ForeignLens::of(fields).and_then(|lens| Ok((lens, matrix(fields)?)));
        Ok(Frame {
            file_path,
            mask_path,
            camera,
        })
    }
}

/// JSON with two liberties that writers take: NaN and infinities, which become null.
fn parse(text: &str) -> Result<Value, (String, String)> {
    serde_json::from_str(text)
        // Python writes NaN and Infinity, which are no JSON.
        // Only where strict JSON fails, so good files are parsed once.
        .or_else(|error| match without_numbers_that_are_none(text) {
            Some(mended) => serde_json::from_str(&mended),
            None => Err(error),
        })
        .map_err(|error| {
            let place = format!("line {}, column {}", error.line(), error.column());
            let fault = if error.is_eof() {
                "the file ends in the middle of a value: it was cut short; copy or write it again"
                    .into()
            } else {
                let said = error.to_string();
                let said = said.split(" at line ").next().unwrap_or(&said);
                format!("is not JSON ({said}); mend it there or write the file again")
            };
            (place, fault)
        })
}

/// The text with NaN and infinities outside of strings as null, padded so that lines and columns
/// stay; `None` if there are none.
fn without_numbers_that_are_none(text: &str) -> Option<String> {
    const WORDS: [&str; 6] = ["-Infinity", "Infinity", "-NaN", "NaN", "-nan", "nan"];
    let mut mended = String::with_capacity(text.len());
    let mut rest = text;
    let mut changed = false;
    while let Some(first) = rest.chars().next() {
        let length = match first {
            // A path may hold `nan`: strings are passed over whole.
            '"' => string_length(rest),
            _ => match WORDS.iter().find(|word| rest.starts_with(**word)) {
                Some(word) => {
                    // As long as the word, so that errors name the right column.
                    mended.push_str(&format!("{:<1$}", "null", word.len()));
                    changed = true;
                    rest = &rest[word.len()..];
                    continue;
                }
                None => first.len_utf8(),
            },
        };
        mended.push_str(&rest[..length]);
        rest = &rest[length..];
    }
    changed.then_some(mended)
}

/// Bytes of the string that a text begins with, quotes and all.
fn string_length(text: &str) -> usize {
    let mut escaped = false;
    for (at, c) in text.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return at + 1,
            _ => {}
        }
    }
    text.len()
}

fn without_frames(fields: &Map<String, Value>) -> String {
    if fields.contains_key("camera_path") {
        return format!(
            "is a camera path of nerfstudio's viewer, whose poses are in coordinates of that viewer's own; {EXPECTED}"
        );
    }
    format!("has no `frames`; {EXPECTED}")
}

fn unused(fields: &Map<String, Value>) -> Vec<String> {
    let lens = ForeignLens::fields();
    let is_unused = |name: &str, read: &[&str]| {
        !read.contains(&name) && !QUIET.contains(&name) && !lens.contains(&name)
    };
    let own = fields.keys().filter(|name| is_unused(name, READ)).cloned();
    let frames = fields.get("frames").and_then(Value::as_array);
    let of_frames = frames
        .into_iter()
        .flatten()
        .filter_map(Value::as_object)
        // Of all frames, since fields may stand in some of them only.
        .flat_map(Map::keys)
        .filter(|name| is_unused(name, READ_OF_FRAMES))
        .map(|name| format!("frames.{name}"));
    let unused: BTreeSet<String> = own.chain(of_frames).collect();
    unused.into_iter().collect()
}

fn matrix(fields: &Map<String, Value>) -> Result<Vec<[f64; 4]>, String> {
    let name = "transform_matrix";
    let rows = match fields.get(name) {
        // Three rows are a matrix as well: the last is always 0 0 0 1.
        Some(Value::Array(rows)) if rows.len() <= 4 => rows,
        Some(_) => return Err(format!("{name} is not four rows of four numbers")),
        None => return Err(format!("has no {name}")),
    };
    rows.iter()
        .map(vector::<4>)
        .collect::<Result<_, _>>()
        .map_err(|fault| format!("{name} {fault}"))
}

/// Exactly N numbers. Fails with what is there instead.
fn vector<const N: usize>(value: &Value) -> Result<[f64; N], String> {
    let values = value.as_array().filter(|values| values.len() == N);
    let values = values.ok_or_else(|| format!("has a row that is not {N} numbers"))?;
    let mut numbers = [0.0; N];
    for (number, value) in numbers.iter_mut().zip(values) {
        *number = value.as_f64().ok_or_else(|| match value {
            Value::Null => "holds a number that is not finite (NaN)".to_owned(),
            other => format!("holds {}; expected a number", kind(other)),
        })?;
    }
    Ok(numbers)
}

fn array<const N: usize, T>(
    fields: &Map<String, Value>,
    name: &str,
    item: fn(&Value) -> Result<T, String>,
) -> Result<Option<[T; N]>, String> {
    let values = match fields.get(name) {
        None | Some(Value::Null) => return Ok(None),
        Some(value) => value.as_array().filter(|values| values.len() == N),
    };
    let values = values.ok_or_else(|| format!("is not a list of {N}"))?;
    let items: Vec<T> = values.iter().map(item).collect::<Result<_, _>>()?;
    Ok(items.try_into().ok())
}

fn array_of_numbers<const N: usize>(
    fields: &Map<String, Value>,
    name: &str,
) -> Result<Option<[f64; N]>, String> {
    match fields.get(name) {
        None | Some(Value::Null) => Ok(None),
        Some(value) => vector(value).map(Some),
    }
}

/// A number, if it is there.
pub(super) fn number(fields: &Map<String, Value>, name: &str) -> Result<Option<f64>, String> {
    match fields.get(name) {
        None | Some(Value::Null) => Ok(None),
        Some(value) => match value.as_f64() {
            Some(number) => Ok(Some(number)),
            None => Err(format!("{name} is {}; expected a number", kind(value))),
        },
    }
}

fn texts(fields: &Map<String, Value>, name: &str) -> Result<Vec<String>, String> {
    let values = match fields.get(name) {
        None | Some(Value::Null) => return Ok(Vec::new()),
        Some(value) => value.as_array(),
    };
    values
        .and_then(|values| {
            let text = |value: &Value| value.as_str().map(str::to_owned);
            values.iter().map(text).collect()
        })
        .ok_or_else(|| "is not a list of paths".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_none_become_null_outside_of_strings() {
        let text = "{\"NaN\": [NaN, 1], \"a\\\"nan\": -Infinity}";
        let mended = without_numbers_that_are_none(text).unwrap();
        assert_eq!(mended, "{\"NaN\": [null, 1], \"a\\\"nan\": null     }");
        assert_eq!(without_numbers_that_are_none("[1, 2]"), None);
    }
}
