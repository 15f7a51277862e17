//! `Encode`: images to latents by the prior's VAE, in f32. Knows nothing of guidance.

use artifacts_schema::{ImageSet, LatentHead, LatentHeads, Latents, StoredImages};
use diffusion::vae::Vae;
use diffusion::{ModelSource, Prior};
use formats::Camera;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::model::Model;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::prior;
use crate::registry::AnyStage;
use crate::shard::{self, Shard};
use crate::size::{Foretold, Size, Sizes, input};
use crate::stage::{Estimate, Stage};

const IMAGES: Port<ImageSet> = Port::new("images");

/// Bytes of a pixel while it is worked on, beside what lies between the layers for a tile.
const WORKED: u64 = 80;
const LATENTS: Port<Latents> = Port::new("latents");

/// Encodes images by the prior's VAE: the mean of its posterior, times its scaling factor (paper
/// section 2.1).
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Encode {
    /// The images.
    pub images: Input,
    /// The prior.
    pub model: ModelSource,
    /// Side of the tiles in image pixels; an image that fits in one is not tiled.
    #[schemars(range(min = 64, max = 8192))]
    pub tile: u32,
    /// In how many parts the views are encoded, each a stage of its own; the latents are the same
    /// for any number.
    #[schemars(range(min = 1))]
    pub shards: u32,
    /// Which of the parts this is, from 1; 0 for all views.
    pub shard: u32,
}

impl Default for Encode {
    fn default() -> Self {
        Self {
            images: Input::default(),
            model: ModelSource::default(),
            tile: 512,
            shards: 1,
            shard: 0,
        }
    }
}

impl Encode {
    /// What is known of the latents before the first is encoded.
    fn heads(&self, images: &StoredImages, vae: &Vae) -> Result<LatentHeads, StageError> {
        let head = |(name, camera): &(String, Camera)| LatentHead {
            name: name.clone(),
            size: [camera.width, camera.height],
            camera: *camera,
            shape: vae
                .latent_shape([camera.height as usize, camera.width as usize])
                .to_vec(),
        };
        Ok(LatentHeads {
            // The whole model's digest stands for its VAE, so that latents of another model are
            // told apart.
            vae: self.model.content()?.to_string(),
            scaling_factor: vae.scaling_factor(),
            views: images.cameras().iter().map(head).collect(),
            bounds: images.bounds,
        })
    }

    /// How large the latents of these images will be.
    fn encoded(&self, images: Size) -> Size {
        images.encoded(prior::latent_bytes(&self.model))
    }

    fn part(&self) -> Shard {
        Shard::new(self.shards, self.shard)
    }
}

impl Stage for Encode {
    fn kind(&self) -> &'static str {
        "Encode"
    }

    fn version(&self) -> u32 {
        4
    }

    fn check(&self) -> Result<(), StageError> {
        convert::in_range("tile", self.tile, 64, 8192)?;
        shard::check(self.shards, self.shard)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![IMAGES.input(&self.images)]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![LATENTS.output()]
    }

    fn model(&self) -> Option<&dyn Model> {
        Some(&self.model)
    }

    fn shards(&self) -> Vec<AnyStage> {
        shard::parts(self.shards, self.shard, |shard| {
            AnyStage::Encode(Self {
                shard,
                ..self.clone()
            })
        })
    }

    fn uses_device(&self) -> bool {
        true
    }

    fn foretell(&self, inputs: &Sizes) -> Foretold {
        let images = self.part().size(input(inputs, IMAGES.name));
        [(LATENTS.name, self.encoded(images))].into()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let inputs = &self.part().sizes(inputs);
        let images = input(inputs, IMAGES.name);
        let pixel = prior::encoding_seconds(&self.model) * prior::in_tiles(images, self.tile);
        let seconds = images.pixels as f64 * pixel;
        let work = WORKED * images.largest + prior::memory(&self.model);
        Estimate::streaming(inputs, self.encoded(images), 0).computing(work, seconds)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let images = self.part().images(io.images(IMAGES)?)?;
        let count = images.cameras().len();
        let prior = Prior::load(&self.model, io.device)?;
        let mut out = io.latent_writer(LATENTS, &self.heads(&images, &prior.vae)?)?;
        for (done, view) in images.views().enumerate() {
            let view = view?;
            let image = convert::signed_array(&view, io.device);
            let latent = prior.vae.encode_image(&image, self.tile as usize);
            out.add(&view.name, &convert::tensor(&latent))?;
            io.progress(done + 1, count, &[])?;
        }
        Ok(out.finish()?)
    }
}
