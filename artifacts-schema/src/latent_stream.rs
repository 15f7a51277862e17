//! Latent images view by view: read when they are asked for and written as they come, so that a set
//! may be larger than memory. The files are those of [`Latents`](crate::Latents) and of
//! [`Residuals`](crate::Residuals).

use std::collections::BTreeMap;
use std::collections::btree_map::IntoIter;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use formats::{Tensor, tensor_file};

use crate::artifact::ArtifactKind;
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::latent_heads::LatentHeads;
use crate::latents::LatentView;
use crate::provenance::Provenance;
use crate::tensors::StoredTensors;

/// The file of a set of latents, or of residuals.
fn file_of(kind: ArtifactKind) -> String {
    format!("{kind}.safetensors")
}

/// Bytes that the numbers of each view take in a file of latents, wherever that lies.
///
/// # Errors
/// A file that cannot be used.
pub fn sizes(file: &Path) -> Result<Vec<u64>, SchemaError> {
    let file = StoredTensors::open(file)?;
    let size = |name: &str| Ok(file.index().entry(name)?.bytes().len() as u64);
    file.index().names().map(size).collect()
}

/// Latent images in a folder. Cameras and shapes are in memory, numbers only while they are looked
/// at.
#[derive(Clone, Debug)]
pub struct StoredLatents {
    kind: ArtifactKind,
    file: StoredTensors,
    heads: LatentHeads,
}

impl StoredLatents {
    /// The set in this folder: latents, or residuals, as `kind` says. No numbers are read.
    ///
    /// # Errors
    /// Where the file cannot be read, or its header cannot be used.
    pub fn open(folder: &Path, kind: ArtifactKind) -> Result<Self, SchemaError> {
        let file = StoredTensors::open(&folder.join(file_of(kind)))?;
        let heads = LatentHeads::read(&file)?;
        Ok(Self { kind, file, heads })
    }

    /// The set as if it held the views at these places alone, which rise. The others are never
    /// read.
    pub fn only(mut self, places: &[usize]) -> Self {
        let views = places.iter().map(|&at| self.heads.views[at].clone());
        self.heads.views = views.collect();
        self
    }

    /// All but the numbers.
    pub fn heads(&self) -> &LatentHeads {
        &self.heads
    }

    /// The place of the view of this name.
    pub fn find(&self, name: &str) -> Option<usize> {
        let views = &self.heads.views;
        views
            .binary_search_by(|view| view.name.as_str().cmp(name))
            .ok()
    }

    /// The view at this place in the order of names.
    ///
    /// # Errors
    /// Where its numbers cannot be read.
    pub fn view(&self, at: usize) -> Result<LatentView, SchemaError> {
        let head = &self.heads.views[at];
        Ok(LatentView {
            name: head.name.clone(),
            size: head.size,
            camera: head.camera,
            tensor: self.file.tensor(&head.name)?,
        })
    }

    /// All views in the order of names.
    pub fn views(&self) -> impl Iterator<Item = Result<LatentView, SchemaError>> + '_ {
        (0..self.heads.views.len()).map(|at| self.view(at))
    }

    /// The semantic digest of the set: the same as of the whole in memory.
    ///
    /// # Errors
    /// A view that cannot be read.
    pub fn semantic_digest(&self) -> Result<Digest, SchemaError> {
        let mut hasher = ContentHasher::new(self.kind);
        self.heads.feed(&mut hasher);
        for view in self.views() {
            view?.feed(&mut hasher);
        }
        Ok(hasher.finish())
    }
}

/// Writes latent images into a folder as they come, in the order of their names.
pub struct LatentWriter {
    path: PathBuf,
    file: File,
    /// The shapes of those that have yet to come.
    awaited: IntoIter<String, Vec<usize>>,
}

impl LatentWriter {
    /// A writer of the set with these heads, into the folder of an artifact of this kind.
    ///
    /// # Errors
    /// Heads that have no form on disk, or a file system that refuses.
    pub fn new(
        folder: &Path,
        kind: ArtifactKind,
        heads: &LatentHeads,
        provenance: &Provenance,
    ) -> Result<Self, SchemaError> {
        heads.check()?;
        let name = file_of(kind);
        canonical::write(folder, &name, &heads.header(provenance)?)?;
        let path = folder.join(name);
        let views = heads.views.iter();
        let shapes = views.map(|view| (view.name.clone(), view.shape.clone()));
        let file = File::options().append(true).open(&path);
        Ok(Self {
            file: file.map_err(|error| SchemaError::io(&path, error))?,
            path,
            awaited: shapes.collect::<BTreeMap<_, _>>().into_iter(),
        })
    }

    /// Takes the numbers of the next view.
    ///
    /// # Errors
    /// Numbers of another shape than its head says, or a file system that refuses.
    pub fn add(&mut self, name: &str, tensor: &Tensor) -> Result<(), SchemaError> {
        let refuse = |problem| Err(SchemaError::content(format!("tensor {name:?}"), problem));
        match self.awaited.next() {
            Some((next, _)) if next != name => return refuse(format!("comes before {next:?}")),
            Some((_, shape)) if shape != tensor.shape => {
                return refuse(format!("has shape {:?}; expected {shape:?}", tensor.shape));
            }
            Some(_) => tensor_file::check(name, &tensor.view())?,
            None => return refuse("is one too many".into()),
        }
        let bytes = tensor.view().values.bytes();
        let written = self.file.write_all(&bytes);
        written.map_err(|error| SchemaError::io(&self.path, error))
    }

    /// Ends the set. A file that lacks numbers cannot be read.
    ///
    /// # Errors
    /// Where a view has not come.
    pub fn finish(mut self) -> Result<(), SchemaError> {
        match self.awaited.next() {
            Some((name, _)) => {
                let place = format!("tensor {name:?}");
                Err(SchemaError::content(place, "is missing"))
            }
            None => Ok(()),
        }
    }
}
