//! Reads a COLMAP reconstruction beside its photos. Knows nothing of what is done with it.
//!
//! Near and far of a photo are percentiles of the depths of the sparse points found in it, as LLFF's are; the scene box
//! is the hull of all frusta between them, and coordinates are those of LLFF scenes (`docs/conventions.md`). Rigs and
//! frames, of which newer versions write files as well, are noted and passed over: every image has its own pose.

mod binary;
mod model;
mod text;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;

use crate::normalize::normalize;
use crate::source_files::{self, Posed};
use crate::{Camera, SceneData, SceneError, image_file, llff_files, pose};
use model::Model;

/// Where the reconstruction may lie in a scene's folder.
const PLACES: [&str; 5] = [
    "sparse/0",
    "sparse",
    "colmap/sparse/0",
    "colmap/sparse",
    ".",
];
/// The files of a reconstruction, without extension.
const FILES: [&str; 3] = ["cameras", "images", "points3D"];
/// Files of newer versions that are not read.
const PASSED_OVER: [&str; 2] = ["rigs", "frames"];
/// Depths below and above these percentiles are taken for mistakes, as in LLFF.
const PERCENTILES: [f64; 2] = [0.1, 99.9];
/// Fewer points in a photo say nothing about its near and far.
const FEWEST_POINTS: usize = 8;

/// A parser of one file, which says where something is wrong and what.
type Parser = fn(&[u8], &mut Model) -> Result<(), (String, String)>;

struct Survey {
    sources: Vec<PathBuf>,
    photos: Vec<Posed>,
    notes: Vec<String>,
}

/// Reads the COLMAP scene in `folder`.
///
/// The reconstruction, binary or text, lies in `sparse/0`, `sparse`, the same under `colmap`, or the folder itself.
/// `images` names the subfolder of photos, which by default is chosen as for [`crate::llff`]; they may be reduced
/// copies. Photos of another size than `size` are resized by an antialiased bicubic filter. Lenses up to OPENCV (k1,
/// k2, p1, p2) are known.
///
/// # Errors
/// Every way in which the files can be unfit, as a [`SceneError`] that names file and record.
pub fn colmap(
    folder: &Path,
    images: Option<&str>,
    size: Option<(u32, u32)>,
) -> Result<SceneData, SceneError> {
    let Survey {
        mut photos, notes, ..
    } = survey(folder, images, size)?;
    let cameras: Vec<Camera> = photos.iter().map(|posed| posed.camera.clone()).collect();
    for (posed, camera) in photos.iter_mut().zip(normalize(&cameras)) {
        posed.camera = camera;
    }
    let cameras: Vec<Camera> = photos.iter().map(|posed| posed.camera.clone()).collect();
    let name = folder
        .file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default();
    let count = photos.len();
    Ok(SceneData {
        photos: source_files::read_photos(&photos, size)?,
        test: Vec::new(),
        bounds: pose::hull(&cameras),
        description: format!(
            "COLMAP scene {name}: {count} photos; average camera at the origin, nearest near plane at 1"
        ),
        notes,
    })
}

/// A digest over the files that [`colmap`] would read with the same arguments: whether the scene on disk has changed.
///
/// # Errors
/// The same as [`colmap`]'s, but for photos that cannot be decoded.
pub fn colmap_digest(
    folder: &Path,
    images: Option<&str>,
    size: Option<(u32, u32)>,
) -> Result<[u8; 32], SceneError> {
    let survey = survey(folder, images, size)?;
    let photos = survey.photos.iter().map(|posed| posed.file.as_path());
    source_files::digest(survey.sources.iter().map(PathBuf::as_path).chain(photos))
}

fn survey(
    folder: &Path,
    images: Option<&str>,
    size: Option<(u32, u32)>,
) -> Result<Survey, SceneError> {
    source_files::check_size(folder, size)?;
    let (sources, model) = read_model(folder)?;
    let photos = llff_files::choose_images(folder, images, size)?;
    let notes = passed_over(&sources[0]);
    let mut survey = Survey {
        sources,
        photos: Vec::new(),
        notes,
    };
    let depths = depths(&model);
    let guess = widest(depths.values().copied());
    let entries: Vec<_> = model.images.iter().collect();
    let names = source_files::view_names(
        &entries
            .iter()
            .map(|(_, image)| image.name.as_str())
            .collect::<Vec<_>>(),
    );
    let mut missing = Vec::new();
    for ((number, image), name) in entries.into_iter().zip(names) {
        let Some(file) = image_file::find(&photos.join(&image.name)) else {
            missing.push(&image.name);
            continue;
        };
        let lens = model.lenses.get(&image.lens).ok_or_else(|| {
            let fault = format!("its camera {} is not among the cameras", image.lens);
            SceneError::content(&survey.sources[1], &image.name, fault)
        })?;
        let [near, far] = depths.get(number).copied().or(guess).unwrap_or([0.0; 2]);
        let camera = Camera {
            camera_to_world: image.camera_to_world,
            near,
            far,
            ..lens.clone()
        };
        survey.photos.push(Posed {
            name,
            camera: source_files::at_size_of_file(&camera, &file)?,
            file,
        });
    }
    if let Some(first) = missing.first() {
        if survey.photos.is_empty() {
            let remedy =
                "the reconstruction names photos in that folder; give another by `images`".into();
            return Err(SceneError::Missing {
                path: photos.join(first),
                expected: "the photo",
                remedy,
            });
        }
        survey.notes.push(format!(
            "{} of {} photos are missing, such as {first}",
            missing.len(),
            model.images.len()
        ));
    }
    survey.photos.sort_by(|a, b| a.name.cmp(&b.name));
    if guess.is_none() {
        guess_depths(&mut survey);
    }
    Ok(survey)
}

/// What lies beside the file of cameras and is not read.
fn passed_over(cameras: &Path) -> Vec<String> {
    let files = PASSED_OVER.map(|name| {
        cameras
            .with_file_name(name)
            .with_extension(cameras.extension().unwrap_or_default())
    });
    let names: Vec<_> = files
        .iter()
        .filter(|file| file.is_file())
        .filter_map(|file| file.file_name()?.to_str())
        .collect();
    match names.is_empty() {
        true => Vec::new(),
        false => vec![format!(
            "{}: not read, since every image has its own pose",
            names.join(" and ")
        )],
    }
}

fn guess_depths(survey: &mut Survey) {
    let cameras: Vec<Camera> = survey
        .photos
        .iter()
        .map(|posed| posed.camera.clone())
        .collect();
    let [near, far] = pose::guess_depths(&cameras);
    survey
        .photos
        .iter_mut()
        .for_each(|posed| [posed.camera.near, posed.camera.far] = [near, far]);
    survey
        .notes
        .push("there are no sparse points: near and far are taken from the cameras alone".into());
}

/// The files and what they say.
fn read_model(folder: &Path) -> Result<(Vec<PathBuf>, Model), SceneError> {
    let parsers: [(&str, [Parser; 3]); 2] = [
        ("bin", [binary::cameras, binary::images, binary::points]),
        ("txt", [text::cameras, text::images, text::points]),
    ];
    for place in PLACES.map(|place| folder.join(place)) {
        for (extension, parsers) in parsers {
            let files = FILES.map(|name| place.join(format!("{name}.{extension}")));
            if files[0].is_file() && files[1].is_file() {
                return parse(files.into_iter().zip(parsers));
            }
        }
    }
    let remedy = format!(
        "there should be cameras.bin and images.bin, or the same as .txt, in one of {}",
        PLACES.join(", ")
    );
    Err(SceneError::Missing {
        path: folder.into(),
        expected: "a COLMAP reconstruction",
        remedy,
    })
}

fn parse(
    files: impl Iterator<Item = (PathBuf, Parser)>,
) -> Result<(Vec<PathBuf>, Model), SceneError> {
    let (mut sources, mut model) = (Vec::new(), Model::default());
    // The points may be missing: some tools leave them out.
    for (path, parser) in files.filter(|(path, _)| path.is_file()) {
        let bytes = source_files::read_file(&path)?;
        parser(&bytes, &mut model)
            .map_err(|(place, fault)| SceneError::content(&path, place, fault))?;
        sources.push(path);
    }
    match model.images.is_empty() {
        true => Err(SceneError::content(
            &sources[1],
            "the file",
            "holds no images; the reconstruction failed",
        )),
        false => Ok((sources, model)),
    }
}

/// Near and far of the images that show enough sparse points, by their numbers.
fn depths(model: &Model) -> BTreeMap<u32, [f64; 2]> {
    let mut seen: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for point in &model.points {
        for number in &point.seen_in {
            let Some(image) = model.images.get(number) else {
                continue;
            };
            // A rigid pose: along the view axis is along -z, from the camera's position.
            let back = image.camera_to_world.z_axis.truncate();
            let depth =
                -back.dot(DVec3::from(point.position) - image.camera_to_world.w_axis.truncate());
            if depth > 0.0 && depth.is_finite() {
                seen.entry(*number).or_default().push(depth);
            }
        }
    }
    let range = |(number, mut depths): (u32, Vec<f64>)| {
        depths.sort_by(f64::total_cmp);
        let [near, far] = PERCENTILES.map(|percent| percentile(&depths, percent));
        (depths.len() >= FEWEST_POINTS && near < far).then_some((number, [near, far]))
    };
    seen.into_iter().filter_map(range).collect()
}

/// The value below which so many percent of sorted values lie, interpolated linearly as NumPy does.
fn percentile(sorted: &[f64], percent: f64) -> f64 {
    let at = percent / 100.0 * (sorted.len() - 1) as f64;
    let (below, part) = (at.floor() as usize, at.fract());
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + part * (sorted[above] - sorted[below])
}

/// The widest range of all: for photos that show too few points to have one of their own.
fn widest(ranges: impl Iterator<Item = [f64; 2]>) -> Option<[f64; 2]> {
    ranges.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}
