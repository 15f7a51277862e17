//! What a file of latent images says before its numbers: which views there are, and their cameras
//! and shapes. Reads and writes no numbers.

use std::collections::BTreeMap;

use formats::{Bounds, Camera, tensor_file};

use crate::canonical;
use crate::digest::ContentHasher;
use crate::error::SchemaError;
use crate::latents::{LatentViewMetadata, LatentsMetadata};
use crate::provenance::Provenance;
use crate::tensors::{self, METADATA_KEY, StoredTensors};

/// A latent image without its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct LatentHead {
    /// The name of the view, as its image set has it.
    pub name: String,
    /// Width and height of the image in pixels, before it was padded for the VAE.
    pub size: [u32; 2],
    /// The camera that sees the image.
    pub camera: Camera,
    /// Channels, height and width.
    pub shape: Vec<usize>,
}

/// Latent images without their numbers: what a file of them begins with.
#[derive(Clone, Debug, PartialEq)]
pub struct LatentHeads {
    /// Which VAE made them: the name or digest of its weights.
    pub vae: String,
    /// What the values were multiplied by after the VAE's encoder; divide by it before its decoder.
    pub scaling_factor: f64,
    /// One for each view, sorted by name.
    pub views: Vec<LatentHead>,
    /// The scene box: its lower and its upper corner.
    pub bounds: Bounds,
}

impl LatentHeads {
    pub(crate) fn read(file: &StoredTensors) -> Result<Self, SchemaError> {
        let metadata: LatentsMetadata = tensors::header(file.index())?;
        // Both ways: each view has a tensor, and each tensor a view.
        // Looked for before the metadata is taken apart below.
        let unknown = |name: &&str| !metadata.views.contains_key(*name);
        let unknown = file.index().names().find(unknown).map(str::to_owned);
        let views = metadata.views.into_iter();
        let views = views.map(|(name, about)| LatentHead::read(file, name, about));
        let views = views.collect::<Result<_, _>>()?;
        if let Some(name) = unknown {
            let problem = "is not in the metadata";
            return Err(file.index().wrong(&name, problem).into());
        }
        Ok(Self {
            vae: metadata.vae,
            scaling_factor: metadata.scaling_factor,
            views,
            bounds: metadata.bounds,
        })
    }

    pub(crate) fn check(&self) -> Result<(), SchemaError> {
        canonical::check_bounds(&self.bounds)?;
        canonical::check_names(self.views.iter().map(|view| view.name.as_str()))?;
        // Latents are divided by it, and JSON has no other numbers.
        if !self.scaling_factor.is_finite() {
            return Err(SchemaError::content(
                "scaling_factor",
                format!("is {}; expected a number", self.scaling_factor),
            ));
        }
        let mut views = self.views.iter();
        views.try_for_each(|view| view.check(&format!("view {:?}", view.name)))
    }

    /// The bytes of their file before the numbers.
    pub(crate) fn header(&self, provenance: &Provenance) -> Result<Vec<u8>, SchemaError> {
        let about = |view: &LatentHead| LatentViewMetadata {
            size: view.size,
            camera: view.camera,
        };
        let views = self.views.iter();
        let page = LatentsMetadata {
            vae: self.vae.clone(),
            scaling_factor: self.scaling_factor,
            bounds: self.bounds,
            views: views.map(|v| (v.name.clone(), about(v))).collect(),
            provenance: provenance.clone(),
        };
        let metadata = BTreeMap::from([
            ("format", "pt".to_owned()),
            (METADATA_KEY, canonical::line(&page)?),
        ]);
        let shapes = self.views.iter();
        let shapes = shapes.map(|view| (view.name.as_str(), view.shape.as_slice()));
        Ok(tensor_file::header(&shapes.collect(), &metadata)?)
    }

    /// Begins the digest of the set; its views follow in order.
    pub(crate) fn feed(&self, hasher: &mut ContentHasher) {
        // Latents of two autoencoders are different things, even with equal numbers.
        hasher.text(&self.vae);
        hasher.real(self.scaling_factor);
        hasher.bounds(&self.bounds);
        hasher.count(self.views.len());
    }
}

impl LatentHead {
    fn read(
        file: &StoredTensors,
        name: String,
        LatentViewMetadata { size, camera }: LatentViewMetadata,
    ) -> Result<Self, SchemaError> {
        // A view without a tensor is named by the file's own error.
        let shape = file.index().reals(&name)?.shape().to_vec();
        let place = format!("tensor {name:?}");
        let head = Self {
            name,
            size,
            camera,
            shape,
        };
        let sound = head.check(&place);
        sound.map_err(|error| error.in_file(file.path()))?;
        Ok(head)
    }

    fn check(&self, place: &str) -> Result<(), SchemaError> {
        canonical::check_camera(&self.camera, place)?;
        match self.shape.len() {
            3 => Ok(()),
            _ => Err(SchemaError::content(
                place,
                format!(
                    "has shape {:?}; expected [channels, height, width]",
                    self.shape
                ),
            )),
        }
    }
}
