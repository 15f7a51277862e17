//! What all codecs share: JSON in one form only, cameras and boxes that it can hold, and names that are safe as file names.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use formats::{Bounds, Camera, bounds, json};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::error::SchemaError;

/// What has no form in JSON.
fn no_json(error: serde_json::Error) -> SchemaError {
    SchemaError::content("JSON", error)
}

/// The one JSON value of `content`, keys sorted.
pub fn value(content: &impl Serialize) -> Result<Value, SchemaError> {
    json::value(content).map_err(no_json)
}

/// The one JSON text of `content`, on one line, in ASCII.
pub fn line(content: &impl Serialize) -> Result<String, SchemaError> {
    json::line(content).map_err(no_json)
}

/// The one JSON text of `content`, indented for people.
pub fn page(content: &impl Serialize) -> Result<String, SchemaError> {
    json::page(content).map_err(no_json)
}

/// Reads a JSON file. Errors name its line and column.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, SchemaError> {
    let text = std::fs::read(path).map_err(|error| SchemaError::io(path, error))?;
    // From bytes, so that text that is not UTF-8 is an error of JSON with its place.
    serde_json::from_slice(&text).map_err(|error| SchemaError::malformed(path, "JSON", error))
}

/// Writes a file into a folder, which is created.
pub fn write(folder: &Path, name: &str, bytes: &[u8]) -> Result<(), SchemaError> {
    std::fs::create_dir_all(folder).map_err(|error| SchemaError::io(folder, error))?;
    let path = folder.join(name);
    // Neither flushed nor renamed: the store does both when it takes the files over.
    std::fs::write(&path, bytes).map_err(|error| SchemaError::io(&path, error))
}

/// The files of a folder with this ending, by their stems.
pub fn by_stem(folder: &Path, ending: &str) -> Result<BTreeMap<String, PathBuf>, SchemaError> {
    let failed = |error| SchemaError::io(folder, error);
    // A sorted map: the order of a folder's entries differs between file systems.
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension() == Some(OsStr::new(ending)) {
            let name = path.file_stem().and_then(OsStr::to_str);
            let name =
                // Names become keys of JSON and of digests, which are Unicode.
                name.ok_or_else(|| SchemaError::malformed(&path, "name", "is not Unicode"))?;
            files.insert(name.to_owned(), path);
        }
    }
    Ok(files)
}

/// Refuses a camera that no file may hold.
pub fn check_camera(camera: &Camera, place: &str) -> Result<(), SchemaError> {
    let refuse = |error| SchemaError::content(place, error);
    camera.check().map_err(refuse)
}

/// Refuses a scene box that JSON cannot hold.
pub fn check_bounds(bounds: &Bounds) -> Result<(), SchemaError> {
    match bounds::not_finite(bounds) {
        Some(number) => Err(SchemaError::content(
            "bounds",
            format!("holds {number}; all must be finite"),
        )),
        None => Ok(()),
    }
}

/// Refuses a way back to the files of a scene that JSON cannot hold.
pub fn check_to_source(to_source: Option<&[[f64; 4]; 4]>) -> Result<(), SchemaError> {
    let mut numbers = to_source.into_iter().flat_map(|rows| rows.as_flattened());
    match numbers.find(|number| !number.is_finite()) {
        Some(number) => Err(SchemaError::content(
            "to_source",
            format!("holds {number}; all must be finite"),
        )),
        None => Ok(()),
    }
}

/// Refuses names that cannot be a file's stem or a tensor's key everywhere.
pub fn check_name(name: &str) -> Result<(), SchemaError> {
    let bad = |c: char| c.is_control() || matches!(c, '/' | '\\' | ':');
    // With an ending 200 bytes stay below file systems' 255; Windows has streams behind `:`.
    if name.is_empty() || name.len() > 200 || name.starts_with('.') || name.contains(bad) {
        return Err(SchemaError::content(
            format!("name {name:?}"),
            "cannot name a file: expected 1 to 200 bytes, no leading dot, no / \\ : or control characters",
        ));
    }
    Ok(())
}

/// Refuses bad names, and a name that comes twice in a sorted sequence.
pub fn check_names<'a>(names: impl Iterator<Item = &'a str>) -> Result<(), SchemaError> {
    let mut previous = None;
    for name in names {
        check_name(name)?;
        // Names come in order, so equal ones are neighbours.
        if previous == Some(name) {
            return Err(twice(name));
        }
        previous = Some(name);
    }
    Ok(())
}

/// Two views of one name.
pub fn twice(name: &str) -> SchemaError {
    SchemaError::content(
        format!("name {name:?}"),
        "is there twice; each view needs its own",
    )
}
