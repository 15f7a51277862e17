//! Posed images: a folder of one EXR per view and one `transforms.json`.

use std::path::Path;

use formats::openexr::{self, Channels, ExrError};
use formats::{Bounds, Camera, Linear, Pixels};
use rayon::prelude::*;

use crate::artifact::{Artifact, ArtifactKind};
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::image_stream::StoredImages;
use crate::provenance::Provenance;
use crate::transforms::{self, Transforms};

/// One posed image. Any f32 may be a pixel, also infinities and NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// The stem of its file: `view_000`.
    pub name: String,
    /// The camera that saw it.
    pub camera: Camera,
    /// Colours, scene-linear and premultiplied, and coverage.
    pub pixels: Pixels<Linear>,
    /// Height x width, depth along the viewing axis in scene units.
    pub depth: Option<Vec<f32>>,
    /// Height x width, which pixels count where some do not: what is masked is neither trained on
    /// nor measured.
    pub mask: Option<Vec<bool>>,
}

/// Posed images of one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageSet {
    /// The images; on disk and when read, sorted by name.
    pub views: Vec<View>,
    /// The scene box: its lower and its upper corner.
    pub bounds: Bounds,
    /// Rows of the similarity that takes the scene's coordinates to those of the files that it was
    /// read from; `None` where they are the same.
    pub to_source: Option<[[f64; 4]; 4]>,
}

/// The file of the view of this name.
pub(crate) fn file_of(name: &str) -> String {
    format!("{name}.exr")
}

/// Writes `transforms.json` of a set: its cameras sorted by name, its box, and its way back to the
/// files that the scene was read from.
pub(crate) fn write_page(
    folder: &Path,
    cameras: &[(&str, Camera)],
    (bounds, to_source): (Bounds, Option<[[f64; 4]; 4]>),
    provenance: &Provenance,
) -> Result<(), SchemaError> {
    canonical::check_bounds(&bounds)?;
    canonical::check_to_source(to_source.as_ref())?;
    let page = canonical::page(&Transforms {
        to_source,
        ..Transforms::new(cameras, bounds, provenance)
    })?;
    canonical::write(folder, transforms::FILE, page.as_bytes())
}

/// The JSON of the attribute `srnerf`. OpenEXR has no attribute for lens distortion: it stands in
/// there as well.
fn about(camera: &Camera, provenance: &Provenance) -> Result<String, SchemaError> {
    let mut about = canonical::value(provenance)?;
    if !camera.distortion.is_none() {
        about["distortion"] = canonical::value(&camera.distortion)?;
    }
    canonical::line(&about)
}

impl View {
    fn to_exr(&self, provenance: &Provenance) -> Result<Vec<u8>, SchemaError> {
        // What the encoder says names no view; the places of our own checks do.
        let refuse = |error: ExrError| match error.place {
            "OpenEXR" => SchemaError::content(format!("view {:?}", self.name), error.problem),
            place => SchemaError::content(place, error.problem),
        };
        openexr::to_bytes(
            &self.camera,
            &self.pixels,
            self.depth.as_deref(),
            self.mask.as_deref(),
            &about(&self.camera, provenance)?,
        )
        .map_err(refuse)
    }

    /// The view of this name and camera whose pixels are in the file at `path`.
    ///
    /// # Errors
    /// Where the file cannot be read, or is no image of the camera's size.
    pub fn from_exr(path: &Path, name: &str, camera: Camera) -> Result<Self, SchemaError> {
        let bytes = std::fs::read(path).map_err(|error| SchemaError::io(path, error))?;
        let Channels {
            pixels,
            depth,
            mask,
        } = openexr::read(&bytes, &camera)
            .map_err(|error| SchemaError::malformed(path, error.place, error.problem))?;
        Ok(Self {
            name: name.to_owned(),
            camera,
            pixels,
            depth,
            mask,
        })
    }

    pub(crate) fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        canonical::write(folder, &file_of(&self.name), &self.to_exr(provenance)?)
    }

    pub(crate) fn feed(&self, hasher: &mut ContentHasher) {
        hasher.text(&self.name);
        hasher.camera(&self.camera);
        hasher.values(&self.pixels.rgb);
        hasher.optional_values(self.pixels.alpha.as_deref());
        hasher.optional_values(self.depth.as_deref());
        hasher.mask(self.mask.as_deref());
    }

    pub(crate) fn check(&self) -> Result<(), SchemaError> {
        let place = format!("view {:?}", self.name);
        canonical::check_camera(&self.camera, &place)?;
        let pixels = self.camera.width as usize * self.camera.height as usize;
        let planes = [
            ("rgb", 3 * pixels, Some(&self.pixels.rgb)),
            ("alpha", pixels, self.pixels.alpha.as_ref()),
            ("depth", pixels, self.depth.as_ref()),
        ];
        for (plane, expected, values) in planes {
            if let Some(values) = values.filter(|values| values.len() != expected) {
                return Err(SchemaError::content(
                    &place,
                    format!("{plane} has {} values; expected {expected}", values.len()),
                ));
            }
        }
        match self.mask.as_ref().map(Vec::len) {
            Some(found) if found != pixels => Err(SchemaError::content(
                &place,
                format!("mask has {found} values; expected {pixels}"),
            )),
            _ => Ok(()),
        }
    }
}

impl ImageSet {
    fn sorted(&self) -> Vec<&View> {
        let mut views: Vec<&View> = self.views.iter().collect();
        // By bytes, the same on every machine.
        views.sort_by(|left, right| left.name.cmp(&right.name));
        views
    }
}

impl Artifact for ImageSet {
    const KIND: ArtifactKind = ArtifactKind::Images;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        let views = self.sorted();
        // All checks come first, so that nothing is written of content that has no form on disk.
        canonical::check_bounds(&self.bounds)?;
        canonical::check_to_source(self.to_source.as_ref())?;
        canonical::check_names(views.iter().map(|view| view.name.as_str()))?;
        views.iter().try_for_each(|view| view.check())?;
        let cameras: Vec<(&str, Camera)> = views
            .iter()
            .map(|view| (view.name.as_str(), view.camera))
            .collect();
        write_page(folder, &cameras, (self.bounds, self.to_source), provenance)?;
        // Each view is a file of its own: the order of writing shows nowhere.
        views
            .par_iter()
            .try_for_each(|view| view.write(folder, provenance))
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        let stored = StoredImages::open(folder)?;
        Ok(Self {
            views: stored.views().collect::<Result<_, _>>()?,
            bounds: stored.bounds,
            to_source: stored.to_source,
        })
    }

    fn semantic_digest(&self) -> Digest {
        let mut hasher = ContentHasher::new(Self::KIND);
        hasher.bounds(&self.bounds);
        hasher.count(self.views.len());
        self.sorted()
            .into_iter()
            .for_each(|view| view.feed(&mut hasher));
        hasher.end_of_images(self.to_source.as_ref())
    }
}
