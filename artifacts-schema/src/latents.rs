//! Latent images of a VAE, and the residuals that an optimisation adds to them: one safetensors
//! file, one tensor per view.

use std::collections::BTreeMap;
use std::path::Path;

use formats::{Bounds, Camera, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifact::{Artifact, ArtifactKind};
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::provenance::Provenance;
use crate::tensors::{self, METADATA_KEY};

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
    vae: String,
    scaling_factor: f64,
    bounds: Bounds,
    views: BTreeMap<String, LatentViewMetadata>,
    provenance: Provenance,
}

/// All of a view but its tensor.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
struct LatentViewMetadata {
    size: [u32; 2],
    camera: Camera,
}

impl Latents {
    fn sorted(&self) -> Vec<&LatentView> {
        let mut views: Vec<&LatentView> = self.views.iter().collect();
        views.sort_by(|left, right| left.name.cmp(&right.name));
        views
    }

    fn check(&self) -> Result<(), SchemaError> {
        canonical::check_bounds(&self.bounds)?;
        // Sorted for the check alone, which looks at neighbours; tensors are written by name.
        canonical::check_names(self.sorted().iter().map(|view| view.name.as_str()))?;
        // Latents are divided by it, and JSON has no other numbers.
        if !self.scaling_factor.is_finite() {
            return Err(SchemaError::content(
                "scaling_factor",
                format!("is {}; expected a number", self.scaling_factor),
            ));
        }
        for view in &self.views {
            let place = format!("view {:?}", view.name);
            canonical::check_camera(&view.camera, &place)?;
            check_rank(&view.tensor, &place)?;
        }
        Ok(())
    }

    fn write_file(
        &self,
        folder: &Path,
        file: &str,
        provenance: &Provenance,
    ) -> Result<(), SchemaError> {
        self.check()?;
        let metadata = LatentsMetadata {
            vae: self.vae.clone(),
            scaling_factor: self.scaling_factor,
            bounds: self.bounds,
            views: self
                .views
                .iter()
                .map(|view| {
                    (
                        view.name.clone(),
                        LatentViewMetadata {
                            size: view.size,
                            camera: view.camera,
                        },
                    )
                })
                .collect(),
            provenance: provenance.clone(),
        };
        let tensors = self.views.iter();
        let tensors = tensors.map(|view| (view.name.as_str(), &view.tensor));
        let metadata = BTreeMap::from([
            ("format", "pt".to_owned()),
            (METADATA_KEY, canonical::line(&metadata)?),
        ]);
        tensors::write(folder, file, tensors, &metadata)
    }

    fn read_file(folder: &Path, file: &str) -> Result<Self, SchemaError> {
        let path = folder.join(file);
        let tensors = tensors::open(&path)?;
        let metadata: LatentsMetadata = tensors::header(&tensors)?;
        // Both ways: each view has a tensor, and each tensor a view.
        // Looked for before the metadata is taken apart below.
        let unknown = |name: &&str| !metadata.views.contains_key(*name);
        let unknown = tensors.names().find(unknown).map(str::to_owned);
        let mut views = Vec::new();
        for (name, LatentViewMetadata { size, camera }) in metadata.views {
            // A view without a tensor is named by the file's own error.
            let tensor = tensors.tensor(&name)?;
            let place = format!("tensor {name:?}");
            canonical::check_camera(&camera, &place).map_err(|error| error.in_file(&path))?;
            check_rank(&tensor, &place).map_err(|error| error.in_file(&path))?;
            views.push(LatentView {
                name,
                size,
                camera,
                tensor,
            });
        }
        if let Some(name) = unknown {
            return Err(tensors.wrong(&name, "is not in the metadata").into());
        }
        Ok(Self {
            vae: metadata.vae,
            scaling_factor: metadata.scaling_factor,
            views,
            bounds: metadata.bounds,
        })
    }

    fn digest(&self, kind: ArtifactKind) -> Digest {
        let mut hasher = ContentHasher::new(kind);
        // Latents of two autoencoders are different things, even with equal numbers.
        hasher.text(&self.vae);
        hasher.real(self.scaling_factor);
        hasher.bounds(&self.bounds);
        hasher.count(self.views.len());
        // By name, so that the digest does not depend on the order of a list.
        for view in self.sorted() {
            hasher.text(&view.name);
            hasher.count(view.size[0] as usize);
            hasher.count(view.size[1] as usize);
            hasher.camera(&view.camera);
            hasher.tensor(&view.tensor);
        }
        hasher.finish()
    }
}

fn check_rank(tensor: &Tensor, place: &str) -> Result<(), SchemaError> {
    match tensor.shape.len() {
        3 => Ok(()),
        _ => Err(SchemaError::content(
            place,
            format!(
                "has shape {:?}; expected [channels, height, width]",
                tensor.shape
            ),
        )),
    }
}

impl Artifact for Latents {
    const KIND: ArtifactKind = ArtifactKind::Latents;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        self.write_file(folder, "latents.safetensors", provenance)
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        Self::read_file(folder, "latents.safetensors")
    }

    fn semantic_digest(&self) -> Digest {
        self.digest(Self::KIND)
    }
}

impl Artifact for Residuals {
    const KIND: ArtifactKind = ArtifactKind::Residuals;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        self.0
            .write_file(folder, "residuals.safetensors", provenance)
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        Latents::read_file(folder, "residuals.safetensors").map(Self)
    }

    fn semantic_digest(&self) -> Digest {
        // By a kind of its own: a residual is no latent, even with the same numbers.
        self.0.digest(Self::KIND)
    }
}
