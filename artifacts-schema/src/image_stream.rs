//! Posed images view by view: read when they are asked for and written as they come, so that a set
//! may be larger than memory. The files are those of an [`ImageSet`](crate::ImageSet).

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use formats::{Bounds, Camera, openexr};
use rayon::prelude::*;

use crate::artifact::ArtifactKind;
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::images::{View, file_of, write_page};
use crate::provenance::Provenance;
use crate::transforms::{self, Transforms};

/// Bytes of the views that are read ahead, or wait to be written, unless one alone has more.
pub const HELD: u64 = 256 << 20;
/// Bytes of a pixel in memory at most: three colours, alpha and depth.
pub const PIXEL: u64 = 20;
/// The file of a set that [`sizes`] takes.
pub const PAGE: &str = transforms::FILE;

/// Bytes of a view of this camera in memory, at most.
fn bytes(camera: &Camera) -> u64 {
    PIXEL * u64::from(camera.width) * u64::from(camera.height)
}

/// Widths and heights of the views of a set by its `transforms.json`, wherever that file lies.
///
/// # Errors
/// A file that cannot be used.
pub fn sizes(page: &Path) -> Result<Vec<(u32, u32)>, SchemaError> {
    let (_, cameras) = Transforms::cameras_of(page)?;
    let cameras = cameras.into_iter();
    Ok(cameras
        .map(|(_, camera)| (camera.width, camera.height))
        .collect())
}

/// Posed images in a folder. Cameras are in memory, pixels only while they are looked at.
#[derive(Clone, Debug)]
pub struct StoredImages {
    folder: PathBuf,
    cameras: Vec<(String, Camera)>,
    /// The scene box: its lower and its upper corner.
    pub bounds: Bounds,
    /// Rows of the similarity that takes the scene's coordinates to those of the files that it was
    /// read from; `None` where they are the same.
    pub to_source: Option<[[f64; 4]; 4]>,
}

impl StoredImages {
    /// The set in this folder. No image is opened.
    ///
    /// # Errors
    /// Where `transforms.json` cannot be used.
    pub fn open(folder: &Path) -> Result<Self, SchemaError> {
        let (transforms, cameras) = Transforms::read(folder)?;
        Ok(Self {
            folder: folder.to_owned(),
            cameras,
            bounds: transforms.aabb,
            to_source: transforms.to_source,
        })
    }

    /// The set as if it held the views at these places alone, which rise. The others are never
    /// read.
    pub fn only(self, places: &[usize]) -> Self {
        let cameras = places.iter().map(|&at| self.cameras[at].clone());
        Self {
            cameras: cameras.collect(),
            ..self
        }
    }

    /// The cameras by view name, sorted.
    pub fn cameras(&self) -> &[(String, Camera)] {
        &self.cameras
    }

    /// Whether any of the images has alpha. Of each only the header is read.
    ///
    /// # Errors
    /// Where an image's header cannot be used.
    pub fn has_alpha(&self) -> Result<bool, SchemaError> {
        let mut alpha = false;
        for (name, _) in &self.cameras {
            let path = self.folder.join(file_of(name));
            // No short cut once there is alpha: a broken file must be named here.
            alpha |= openexr::has_alpha(&path)
                .map_err(|error| SchemaError::malformed(&path, error.place, error.problem))?;
        }
        Ok(alpha)
    }

    /// The view at this place in the order of names.
    ///
    /// # Errors
    /// Where its file cannot be read, or is no image of the camera's size.
    pub fn view(&self, at: usize) -> Result<View, SchemaError> {
        let (name, camera) = &self.cameras[at];
        View::from_exr(&self.folder.join(file_of(name)), name, *camera)
    }

    /// The place of the view of this name.
    pub fn find(&self, name: &str) -> Option<usize> {
        let own = |(own, _): &(String, Camera)| own.as_str().cmp(name);
        self.cameras.binary_search_by(own).ok()
    }

    /// All views in the order of names, some of them read ahead by all threads.
    pub fn views(&self) -> impl Iterator<Item = Result<View, SchemaError>> + '_ {
        self.map(|view| view)
    }

    /// What `each` makes of the views, in the order of names; some are read ahead by all threads.
    pub fn map<T: Send>(
        &self,
        each: impl Fn(View) -> T + Sync,
    ) -> impl Iterator<Item = Result<T, SchemaError>> {
        self.groups().into_iter().flat_map(move |group| {
            // Of several broken views the first is named, however many threads there are.
            group
                .into_par_iter()
                .map(|at| self.view(at).map(&each))
                .collect::<Vec<_>>()
        })
    }

    /// The views that are read together: as many as there are threads, if they are not too large.
    fn groups(&self) -> Vec<Range<usize>> {
        let most = rayon::current_num_threads().max(1);
        let mut groups = Vec::new();
        let mut begin = 0;
        let mut held = 0;
        for (at, (_, camera)) in self.cameras.iter().enumerate() {
            let bytes = bytes(camera);
            if at > begin && (at - begin == most || held + bytes > HELD) {
                groups.push(begin..at);
                begin = at;
                held = 0;
            }
            held += bytes;
        }
        groups.push(begin..self.cameras.len());
        groups
    }

    /// The semantic digest of the set: the same as of the whole in memory.
    ///
    /// # Errors
    /// A view that cannot be read.
    pub fn semantic_digest(&self) -> Result<Digest, SchemaError> {
        let mut hasher = ContentHasher::new(ArtifactKind::Images);
        hasher.bounds(&self.bounds);
        hasher.count(self.cameras.len());
        for view in self.views() {
            view?.feed(&mut hasher);
        }
        Ok(hasher.end_of_images(self.to_source.as_ref()))
    }
}

/// Writes posed images into a folder as they come, in any order. Equal images leave equal files, as
/// [`ImageSet::write`](crate::Artifact::write) does.
pub struct ImageWriter<'p> {
    folder: PathBuf,
    provenance: &'p Provenance,
    bounds: Bounds,
    to_source: Option<[[f64; 4]; 4]>,
    cameras: BTreeMap<String, Camera>,
    /// Views that wait until there is one for each thread.
    held: Vec<View>,
}

impl<'p> ImageWriter<'p> {
    /// A writer of a set with this box, and this way back to the files that the scene was read from.
    pub fn new(
        folder: &Path,
        bounds: Bounds,
        to_source: Option<[[f64; 4]; 4]>,
        provenance: &'p Provenance,
    ) -> Self {
        Self {
            folder: folder.to_owned(),
            provenance,
            bounds,
            to_source,
            cameras: BTreeMap::new(),
            held: Vec::new(),
        }
    }

    /// Takes a view, and may leave it for later.
    ///
    /// # Errors
    /// A view that has no form on disk or whose name another has, or a file system that refuses.
    pub fn add(&mut self, view: View) -> Result<(), SchemaError> {
        canonical::check_name(&view.name)?;
        view.check()?;
        if self
            .cameras
            .insert(view.name.clone(), view.camera)
            .is_some()
        {
            return Err(canonical::twice(&view.name));
        }
        self.held.push(view);
        let bytes: u64 = self.held.iter().map(|view| bytes(&view.camera)).sum();
        if self.held.len() >= rayon::current_num_threads() || bytes >= HELD {
            self.flush()?;
        }
        Ok(())
    }

    /// Ends the set. Without this the folder holds no set.
    ///
    /// # Errors
    /// A box that has no form on disk, or a file system that refuses.
    pub fn finish(mut self) -> Result<(), SchemaError> {
        self.flush()?;
        let cameras: Vec<(&str, Camera)> = self
            .cameras
            .iter()
            .map(|(name, camera)| (name.as_str(), *camera))
            .collect();
        write_page(
            &self.folder,
            &cameras,
            (self.bounds, self.to_source),
            self.provenance,
        )
    }

    fn flush(&mut self) -> Result<(), SchemaError> {
        // Each view is a file of its own: the order of writing shows nowhere.
        let written: Vec<Result<(), SchemaError>> = self
            .held
            .par_drain(..)
            .map(|view| view.write(&self.folder, self.provenance))
            .collect();
        // The first fault in order: collected at once, it would be any thread's.
        written.into_iter().collect()
    }
}
