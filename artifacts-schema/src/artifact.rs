//! What every artifact type can do: be written, be read, and say what it is by a digest of its
//! content.

use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::digest::Digest;
use crate::error::SchemaError;
use crate::figures;
use crate::provenance::Provenance;
use crate::{Field, Film, Log, Lora, Metrics, StoredImages, StoredLatents};

/// The artifact types. Stages declare them for their inputs and outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ArtifactKind {
    /// Posed images: [`ImageSet`](crate::ImageSet).
    Images,
    /// Latent images of a VAE: [`Latents`](crate::Latents).
    Latents,
    /// What an optimisation adds to latents: [`Residuals`](crate::Residuals).
    Residuals,
    /// Low-rank weights: [`Lora`].
    Lora,
    /// A radiance field: [`Field`].
    Field,
    /// Scores: [`Metrics`].
    Metrics,
    /// What happened, line by line: [`Log`].
    Log,
    /// Pictures for people: [`Figures`](crate::Figures).
    Figures,
    /// Moving pictures for people: [`Film`].
    Film,
}

impl ArtifactKind {
    /// All types, in the order of the variants.
    pub const ALL: [Self; 9] = [
        Self::Images,
        Self::Latents,
        Self::Residuals,
        Self::Lora,
        Self::Field,
        Self::Metrics,
        Self::Log,
        Self::Figures,
        Self::Film,
    ];

    /// The kind's name: lower case, one word.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Images => "images",
            Self::Latents => "latents",
            Self::Residuals => "residuals",
            Self::Lora => "lora",
            Self::Field => "field",
            Self::Metrics => "metrics",
            Self::Log => "log",
            Self::Figures => "figures",
            Self::Film => "film",
        }
    }
}

impl fmt::Display for ArtifactKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        // By `pad`, so that tables can align it.
        out.pad(self.name())
    }
}

/// Something that lies in a folder of its own.
pub trait Artifact: Sized {
    /// The type by which stages declare it.
    const KIND: ArtifactKind;

    /// Writes its files into `folder`, which is created. Equal content and equal provenance give
    /// equal bytes.
    ///
    /// # Errors
    /// Content that has no form on disk (a value without a number, two views of one name), or a
    /// file system that refuses.
    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError>;

    /// Reads what [`Artifact::write`] wrote.
    ///
    /// # Errors
    /// Files that are missing, cut off or otherwise not what was written. Never panics, whatever
    /// the files hold.
    fn read(folder: &Path) -> Result<Self, SchemaError>;

    /// The digest of names, shapes, values and cameras: not of provenance, nor of the files'
    /// layout. All NaNs count as one, and -0.0 as 0.0.
    fn semantic_digest(&self) -> Digest;
}

/// The semantic digest of the artifact that lies in `folder`.
///
/// # Errors
/// As [`Artifact::read`].
pub fn semantic_digest(kind: ArtifactKind, folder: &Path) -> Result<Digest, SchemaError> {
    // Of what was read, so that a file that cannot be read back never becomes a result.
    fn digest<A: Artifact>(folder: &Path) -> Result<Digest, SchemaError> {
        Ok(A::read(folder)?.semantic_digest())
    }
    match kind {
        // View by view, since a set may be larger than memory.
        ArtifactKind::Images => StoredImages::open(folder)?.semantic_digest(),
        ArtifactKind::Latents | ArtifactKind::Residuals => {
            StoredLatents::open(folder, kind)?.semantic_digest()
        }
        ArtifactKind::Lora => digest::<Lora>(folder),
        ArtifactKind::Field => digest::<Field>(folder),
        ArtifactKind::Metrics => digest::<Metrics>(folder),
        ArtifactKind::Log => digest::<Log>(folder),
        ArtifactKind::Figures => figures::semantic_digest_of(folder),
        ArtifactKind::Film => digest::<Film>(folder),
    }
}
