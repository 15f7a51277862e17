//! The files of a reconstruction: where they may lie, and which to take of several. Knows no
//! photos.

use std::path::{Path, PathBuf};

use super::model::Model;
use super::{binary, text};
use crate::{SceneError, source_files};

/// Where the reconstruction may lie in a scene's folder.
const PLACES: [&str; 7] = [
    "sparse",
    "colmap/sparse",
    "dense/sparse",
    ".",
    "colmap",
    "dense",
    "model",
];
/// The files of a reconstruction, without extension.
const FILES: [&str; 3] = ["cameras", "images", "points3D"];
/// Files of newer versions that are not read.
const PASSED_OVER: [&str; 2] = ["rigs", "frames"];
/// More models than any mapper leaves.
const MOST_MODELS: u32 = 100;

/// A parser of one file, which says where something is wrong and what.
type Parser = fn(&[u8], &mut Model) -> Result<(), (String, String)>;

// Binary comes first: it is what COLMAP writes by default.
const PARSERS: [(&str, [Parser; 3]); 2] = [
    ("bin", [binary::cameras, binary::images, binary::points]),
    ("txt", [text::cameras, text::images, text::points]),
];

/// A reconstruction and the files that it was read from: cameras, images, and points if there are
/// any.
pub(super) struct Reconstruction {
    pub(super) sources: Vec<PathBuf>,
    pub(super) model: Model,
    pub(super) notes: Vec<String>,
}

/// The models in each place where a reconstruction may lie.
fn places(folder: &Path) -> impl Iterator<Item = Vec<Place>> {
    PLACES.iter().map(|place| models_in(&folder.join(place)))
}

/// Whether a reconstruction lies in a scene's folder.
pub(super) fn are_in(folder: &Path) -> bool {
    places(folder).any(|models| !models.is_empty())
}

/// Reads the reconstruction in a scene's folder; of several the one with the most photos.
pub(super) fn read(folder: &Path) -> Result<Reconstruction, SceneError> {
    let found = places(folder).find(|models| !models.is_empty());
    let Some(models) = found else {
        let remedy = "there should be cameras.bin and images.bin, or the same as .txt, in one of sparse/0, sparse, \
                      colmap/sparse/0, colmap/sparse, dense/sparse and the folder itself";
        return Err(SceneError::Missing {
            path: folder.into(),
            expected: "a COLMAP reconstruction",
            remedy: remedy.into(),
        });
    };
    let mut notes = Vec::new();
    let chosen = match models.as_slice() {
        [only] => only.clone(),
        several => largest(several, &mut notes)?,
    };
    let model = parse(&chosen, &FILES, &mut notes)?;
    if model.images.is_empty() {
        let path = chosen.file("images");
        let fault = "holds no images; the reconstruction failed";
        return Err(SceneError::content(&path, "the file", fault));
    }
    notes.extend(chosen.passed_over());
    let sources = FILES.map(|name| chosen.file(name));
    Ok(Reconstruction {
        sources: sources.into_iter().filter(|path| path.is_file()).collect(),
        model,
        notes,
    })
}

/// A folder with a reconstruction, and whether its files are binary or text.
#[derive(Clone, Debug)]
struct Place {
    folder: PathBuf,
    extension: &'static str,
    parsers: [Parser; 3],
}

impl Place {
    fn at(folder: &Path) -> Option<Self> {
        PARSERS.into_iter().find_map(|(extension, parsers)| {
            let place = Place {
                folder: folder.to_owned(),
                extension,
                parsers,
            };
            let there = |name| place.file(name).is_file();
            // Without points a scene can still be read, so these two tell.
            (there("cameras") && there("images")).then_some(place)
        })
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.{}", self.extension))
    }

    /// What lies beside the file of cameras and is not read.
    fn passed_over(&self) -> Option<String> {
        let names: Vec<String> = PASSED_OVER
            .iter()
            .filter(|name| self.file(name).is_file())
            .map(|name| format!("{name}.{}", self.extension))
            .collect();
        (!names.is_empty()).then(|| {
            format!(
                "{}: not read, since every image has its own pose",
                names.join(" and ")
            )
        })
    }
}

/// The models that a mapper left in a folder, by number; else the one that lies right in it.
fn models_in(folder: &Path) -> Vec<Place> {
    // A mapper leaves a model for each group of photos that it could not join: 0, 1, 2 and so on.
    let numbered: Vec<Place> = (0..MOST_MODELS)
        .filter_map(|number| Place::at(&folder.join(number.to_string())))
        .collect();
    match numbered.is_empty() {
        true => Place::at(folder).into_iter().collect(),
        false => numbered,
    }
}

/// The model with the most photos, the first of equals. The others are noted.
fn largest(models: &[Place], notes: &mut Vec<String>) -> Result<Place, SceneError> {
    let mut counted = Vec::new();
    for place in models {
        // Only their images are counted; points would be read for nothing.
        let model = parse(place, &["images"], &mut Vec::new())?;
        counted.push((model.images.len(), place));
    }
    // Of equals the first by number, so that the choice does not depend on the file system.
    let most = counted.iter().map(|(count, _)| *count).max().unwrap_or(0);
    let chosen = counted.iter().find(|(count, _)| *count == most);
    let (_, chosen) =
        chosen.ok_or_else(|| SceneError::content(&models[0].folder, "it", "is empty"))?;
    let name = |place: &Place| {
        let name = place.folder.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    };
    let sizes: Vec<String> = counted
        .iter()
        .map(|(count, place)| format!("{} with {count} photos", name(place)))
        .collect();
    notes.push(format!(
        "there are {} reconstructions ({}): {} is read; their coordinates differ, so the others are left out",
        models.len(),
        sizes.join(", "),
        name(chosen)
    ));
    Ok((*chosen).clone())
}

fn parse(place: &Place, names: &[&str], notes: &mut Vec<String>) -> Result<Model, SceneError> {
    let mut model = Model::default();
    for (name, parser) in FILES.iter().zip(place.parsers) {
        let path = place.file(name);
        // The points may be missing: some tools leave them out.
        if !names.contains(name) || !path.is_file() {
            continue;
        }
        let bytes = source_files::read_file(&path)?;
        parser(&bytes, &mut model)
            .map_err(|(place, fault)| SceneError::content(&path, place, fault))?;
    }
    notes.append(&mut model.notes);
    Ok(model)
}
