//! Latent images of a VAE, and the residuals that an optimisation adds to them: one safetensors
//! file, one tensor per view.

use std::collections::BTreeMap;
use std::path::Path;

use formats::{Bounds, Camera, Tensor, tensor_file};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifact::{Artifact, ArtifactKind};
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::latent_heads::{LatentHead, LatentHeads};
use crate::latent_stream::{LatentWriter, StoredLatents};
use crate::provenance::Provenance;

/// Latent images of posed views.
#[derive(Clone, Debug, PartialEq)]
pub struct Latents {
    /// Which VAE made them: the name or digest of its weights.
    pub vae: String,
    /// What the values were multiplied by after the VAE's encoder; divide by it before its decoder.
    pub scaling_factor: f64,
    /// One latent per view; on disk and when read, sorted by name.
    pub views: Vec<LatentView>,
    /// The scene box: its lower and its upper corner.
    pub bounds: Bounds,
}

/// The latent image of one view.
#[derive(Clone, Debug, PartialEq)]
pub struct LatentView {
    /// The name of the view, as its image set has it.
    pub name: String,
    /// Width and height of the image in pixels, before it was padded for the VAE.
    pub size: [u32; 2],
    /// The camera that sees the image.
    pub camera: Camera,
    /// Channels x height x width.
    pub tensor: Tensor,
}

/// What an optimisation adds to latents: zero where it changed nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Residuals(pub Latents);

/// The JSON in the file's metadata.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub(crate) struct LatentsMetadata {
    pub vae: String,
    pub scaling_factor: f64,
    pub bounds: Bounds,
    pub views: BTreeMap<String, LatentViewMetadata>,
    pub provenance: Provenance,
}

/// All of a view but its tensor.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub(crate) struct LatentViewMetadata {
    pub size: [u32; 2],
    pub camera: Camera,
}

impl Latents {
    fn sorted(&self) -> Vec<&LatentView> {
        let mut views: Vec<&LatentView> = self.views.iter().collect();
        views.sort_by(|left, right| left.name.cmp(&right.name));
        views
    }

    /// All but the numbers.
    fn heads(&self) -> LatentHeads {
        let views = self.sorted().into_iter();
        LatentHeads {
            vae: self.vae.clone(),
            scaling_factor: self.scaling_factor,
            views: views.map(LatentView::head).collect(),
            bounds: self.bounds,
        }
    }

    fn write_as(
        &self,
        kind: ArtifactKind,
        folder: &Path,
        provenance: &Provenance,
    ) -> Result<(), SchemaError> {
        let heads = self.heads();
        // All checks come first, so that nothing is written of content that has no form on disk.
        heads.check()?;
        for view in &self.views {
            tensor_file::check(&view.name, &view.tensor.view())?;
        }
        let mut writer = LatentWriter::new(folder, kind, &heads, provenance)?;
        for view in self.sorted() {
            writer.add(&view.name, &view.tensor)?;
        }
        writer.finish()
    }

    fn read_as(kind: ArtifactKind, folder: &Path) -> Result<Self, SchemaError> {
        let stored = StoredLatents::open(folder, kind)?;
        let views = stored.views().collect::<Result<_, _>>()?;
        let LatentHeads {
            vae,
            scaling_factor,
            bounds,
            ..
        } = stored.heads().clone();
        Ok(Self {
            vae,
            scaling_factor,
            views,
            bounds,
        })
    }

    fn digest(&self, kind: ArtifactKind) -> Digest {
        let mut hasher = ContentHasher::new(kind);
        self.heads().feed(&mut hasher);
        // By name, so that the digest does not depend on the order of a list.
        let views = self.sorted().into_iter();
        views.for_each(|view| view.feed(&mut hasher));
        hasher.finish()
    }
}

impl LatentView {
    /// All but the numbers.
    fn head(&self) -> LatentHead {
        LatentHead {
            name: self.name.clone(),
            size: self.size,
            camera: self.camera,
            shape: self.tensor.shape.clone(),
        }
    }

    pub(crate) fn feed(&self, hasher: &mut ContentHasher) {
        hasher.text(&self.name);
        hasher.count(self.size[0] as usize);
        hasher.count(self.size[1] as usize);
        hasher.camera(&self.camera);
        hasher.tensor(&self.tensor);
    }
}

impl Artifact for Latents {
    const KIND: ArtifactKind = ArtifactKind::Latents;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        self.write_as(Self::KIND, folder, provenance)
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        Self::read_as(Self::KIND, folder)
    }

    fn semantic_digest(&self) -> Digest {
        self.digest(Self::KIND)
    }
}

impl Artifact for Residuals {
    const KIND: ArtifactKind = ArtifactKind::Residuals;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        self.0.write_as(Self::KIND, folder, provenance)
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        Latents::read_as(Self::KIND, folder).map(Self)
    }

    fn semantic_digest(&self) -> Digest {
        // By a kind of its own: a residual is no latent, even with the same numbers.
        self.0.digest(Self::KIND)
    }
}
