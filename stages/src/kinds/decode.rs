//! `Decode`: refined latents back to images. Knows nothing of how they were refined.

use artifacts_schema::{ImageSet, LatentView, Latents, Residuals, StoredImages, View};
use compute::Array;
use compute::elementwise::{add, clamp, sub};
use diffusion::{ModelSource, Prior};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::back_projection::back_project;
use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::masks;
use crate::model::Model;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::prior;
use crate::registry::AnyStage;
use crate::shard::{self, Shard};
use crate::size::{Foretold, Size, Sizes, input};
use crate::stage::{Estimate, Stage};

const LATENTS: Port<Latents> = Port::new("latents");
const RESIDUALS: Port<Residuals> = Port::new("residuals");
/// The images that were encoded, and those that come out.
const IMAGES: Port<ImageSet> = Port::new("images");
const LOW: Port<ImageSet> = Port::new("low");

/// Bytes of a pixel while it is worked on, beside what lies between the layers for a tile.
const WORKED: u64 = 160;

/// Decodes refined latents z + h by the prior's VAE, D.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Decode {
    /// The refined latents, z + h.
    pub latents: Input,
    /// How an image is made of them.
    pub mode: Mode,
    /// For `Residual`: the residual latents, h.
    pub residuals: Input,
    /// For `Residual`: the images that were encoded, x. Where there are any, their alpha is that of
    /// the result: the prior knows colours only, and sees them before black.
    pub images: Input,
    /// Rounds of back-projection onto the low-resolution views: each adds the enlarged difference
    /// between them and the reduced image. 0 turns it off.
    #[schemars(range(min = 0, max = 1000))]
    pub back_projection: u32,
    /// For back-projection: the low-resolution views.
    pub low: Input,
    /// The prior.
    pub model: ModelSource,
    /// Side of the tiles in image pixels; an image that fits in one is not tiled.
    #[schemars(range(min = 64, max = 8192))]
    pub tile: u32,
    /// In how many parts the views are decoded, each a stage of its own; the images are the same
    /// for any number.
    #[schemars(range(min = 1))]
    pub shards: u32,
    /// Which of the parts this is, from 1; 0 for all views.
    pub shard: u32,
}

/// How an image is made of refined latents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Mode {
    /// D(z + h), as in the paper (algorithm 2).
    Plain,
    /// x + D(z + h) - D(z): the autoencoder's own loss cancels, and h = 0 gives x exactly.
    Residual,
}

impl Default for Decode {
    fn default() -> Self {
        Self {
            latents: Input::default(),
            mode: Mode::Plain,
            residuals: Input::default(),
            images: Input::default(),
            back_projection: 0,
            low: Input::default(),
            model: ModelSource::default(),
            tile: 512,
            shards: 1,
            shard: 0,
        }
    }
}

/// The folders' contents that belong to one view.
struct Parts {
    latent: LatentView,
    residual: Option<LatentView>,
    image: Option<View>,
    low: Option<View>,
}

impl Decode {
    /// The image of one view in [-1, 1].
    fn image(&self, prior: &Prior, parts: &Parts, io: &Io) -> Array {
        let [width, height] = parts.latent.size;
        let size = [height as usize, width as usize];
        let refined = convert::latent_array(&parts.latent.tensor, io.device);
        let decode = |latent: &Array| prior.vae.decode_latent(latent, size, self.tile as usize);
        let (Mode::Residual, Some(residual), Some(image)) =
            (self.mode, &parts.residual, &parts.image)
        else {
            return clamp(&decode(&refined), -1.0, 1.0);
        };
        let image = convert::signed_array(image, io.device);
        // Of many views a few steps look at some alone. D(z) - D(z) is 0 to the last digit.
        if residual.tensor.values.iter().all(|h| *h == 0.0) {
            return clamp(&image, -1.0, 1.0);
        }
        // z is what the refined latent z + h is without h, so it need not be an input.
        let encoded = sub(
            &refined,
            &convert::latent_array(&residual.tensor, io.device),
        );
        // By the same tiles, so that what the autoencoder loses is nearly the same in both and
        // cancels.
        let difference = sub(&decode(&refined), &decode(&encoded));
        clamp(&add(&image, &difference), -1.0, 1.0)
    }

    fn view(&self, prior: &Prior, parts: &Parts, io: &Io) -> View {
        let mut image = self.image(prior, parts, io);
        if let Some(low) = &parts.low {
            let counts = masks::factors(low, 3, io.device);
            // After the decoder: its own loss would undo what came before it.
            let low = convert::signed_array(low, io.device);
            let rounds = self.back_projection;
            image = back_project(image, &low, counts.as_ref(), rounds, [-1.0, 1.0]);
        }
        let image_of = parts.image.as_ref();
        let alpha = image_of.and_then(|image| image.pixels.alpha.clone());
        let [width, height] = parts.latent.size;
        let mask = |view: &View| masks::at_size(view, width, height);
        let mask = masks::both(image_of.and_then(mask), parts.low.as_ref().and_then(mask));
        View {
            name: parts.latent.name.clone(),
            camera: parts.latent.camera,
            pixels: convert::disk_pixels_of_signed(&image, alpha),
            depth: None,
            mask,
        }
    }

    /// How large the images will be.
    fn decoded(&self, inputs: &Sizes) -> Size {
        let images = input(inputs, IMAGES.name);
        if images.pixels > 0 {
            return self.part().size(images);
        }
        let latents = self.part().size(input(inputs, LATENTS.name));
        latents.decoded(prior::latent_bytes(&self.model))
    }

    fn part(&self) -> Shard {
        Shard::new(self.shards, self.shard)
    }

    /// Whether the images that were encoded are read.
    fn takes_images(&self) -> bool {
        self.mode == Mode::Residual || !self.images.0.is_empty()
    }
}

impl Stage for Decode {
    fn kind(&self) -> &'static str {
        "Decode"
    }

    fn version(&self) -> u32 {
        7
    }

    fn check(&self) -> Result<(), StageError> {
        convert::in_range("back_projection", self.back_projection, 0, 1000)?;
        convert::in_range("tile", self.tile, 64, 8192)?;
        shard::check(self.shards, self.shard)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        let residual = self.mode == Mode::Residual;
        vec![
            LATENTS.input(&self.latents),
            RESIDUALS.input(&self.residuals).only_if(residual),
            IMAGES.input(&self.images).only_if(self.takes_images()),
            LOW.input(&self.low).only_if(self.back_projection > 0),
        ]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![IMAGES.output()]
    }

    fn model(&self) -> Option<&dyn Model> {
        Some(&self.model)
    }

    fn shards(&self) -> Vec<AnyStage> {
        shard::parts(self.shards, self.shard, |shard| {
            AnyStage::Decode(Self {
                shard,
                ..self.clone()
            })
        })
    }

    fn uses_device(&self) -> bool {
        true
    }

    fn foretell(&self, inputs: &Sizes) -> Foretold {
        [(IMAGES.name, self.decoded(inputs))].into()
    }

    fn estimate(&self, inputs: &Sizes) -> Estimate {
        let written = self.decoded(inputs);
        let inputs = &self.part().sizes(inputs);
        let pixel = prior::decoding_seconds(&self.model) * prior::in_tiles(written, self.tile);
        let seconds = written.pixels as f64 * pixel;
        Estimate::streaming(inputs, written, WORKED).computing(prior::memory(&self.model), seconds)
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let latents = self.part().latents(io.latents(LATENTS)?)?;
        let count = latents.heads().views.len();
        let residual = self.mode == Mode::Residual;
        let residuals = residual.then(|| io.latents(RESIDUALS)).transpose()?;
        let takes_images = self.takes_images();
        let images = takes_images.then(|| io.images(IMAGES)).transpose()?;
        let projects = self.back_projection > 0;
        let low = projects.then(|| io.images(LOW)).transpose()?;
        // Latents do not carry where the scene came from; the images beside them do.
        let to_source = [&images, &low]
            .into_iter()
            .flatten()
            .find_map(|i| i.to_source);
        let prior = Prior::load(&self.model, io.device)?;
        let mut out = io.image_writer(IMAGES, latents.heads().bounds, to_source);
        for (done, latent) in latents.views().enumerate() {
            let latent = latent?;
            let named = |images: &Option<StoredImages>| {
                let images = images.as_ref();
                images
                    .map(|images| convert::view_named(images, &latent.name))
                    .transpose()
            };
            let residual = residuals.as_ref();
            let parts = Parts {
                residual: residual
                    .map(|residuals| convert::latent_named(residuals, &latent.name))
                    .transpose()?,
                image: named(&images)?,
                low: named(&low)?,
                latent,
            };
            out.add(self.view(&prior, &parts, io))?;
            io.progress(done + 1, count, &[])?;
        }
        Ok(out.finish()?)
    }
}
