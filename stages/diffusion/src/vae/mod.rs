//! `AutoencoderKL` of diffusers: images to latents and back, in f32, of any size.
//!
//! Knows nothing of diffusion but the factor that latents are scaled by for it.

mod coder;
mod statistics;
mod tiles;

use compute::elementwise::{clamp, scale};
use compute::shape::{concat, crop, pad_reflect, slice};
use compute::{Array, Device};

use crate::config::VaeConfig;
use crate::error::ModelError;
use crate::layers::Conv2d;
use crate::network::Network;
use crate::source::ModelSource;
use crate::weights::Weights;
use coder::Coder;
use statistics::Statistics;
use tiles::Tiling;

/// The smallest tile, in latent pixels.
const MIN_TILE: usize = 8;

/// A variational autoencoder between images and latents.
pub struct Vae {
    config: VaeConfig,
    encoder: Coder,
    quant: Option<Conv2d>,
    post_quant: Option<Conv2d>,
    decoder: Coder,
}

/// The distribution of latents that the encoder gives for an image: normal and independent in each
/// element `[N, C, h, w]`, unscaled.
#[derive(Clone, Debug)]
pub struct Posterior {
    /// The means of the latents.
    pub mean: Array,
    /// Logarithms of variances, within [-30, 20] as diffusers bounds them.
    pub logvar: Array,
}

impl Vae {
    /// Reads the autoencoder of `source` onto `device`. The error names the file, and the field or
    /// tensor in it.
    pub fn load(source: &ModelSource, device: &Device) -> Result<Self, ModelError> {
        let config = VaeConfig::read(&source.file("vae/config.json")?)?;
        Self::read(config, source.weights(Network::Vae, device)?)
    }

    /// Reads the autoencoder. Fails if the file does not hold exactly the tensors that the
    /// configuration asks for.
    fn read(config: VaeConfig, mut weights: Weights) -> Result<Self, ModelError> {
        // Before anything is read: the layers ask by today's names.
        weights.rename(current_name);
        let root = weights.root();
        let latent = config.latent_channels;
        let quant = config
            .use_quant_conv
            .then(|| Conv2d::pointwise(&root.at("quant_conv"), 2 * latent, 2 * latent));
        let post = config
            .use_post_quant_conv
            .then(|| Conv2d::pointwise(&root.at("post_quant_conv"), latent, latent));
        let vae = Self {
            encoder: Coder::encoder(&config, &root.at("encoder"))?,
            quant: quant.transpose()?,
            post_quant: post.transpose()?,
            decoder: Coder::decoder(&config, &root.at("decoder"))?,
            config,
        };
        weights.finish(&[])?;
        Ok(vae)
    }

    /// What its `config.json` says.
    pub fn config(&self) -> &VaeConfig {
        &self.config
    }

    /// How many image pixels a latent pixel spans each way: 4 for the x4 upscaler.
    pub fn factor(&self) -> usize {
        // Every block but the last one halves.
        1 << (self.config.block_out_channels.len() - 1)
    }

    /// What a latent is multiplied by before the UNet sees it.
    pub fn scaling_factor(&self) -> f64 {
        self.config.scaling_factor
    }

    /// Encodes `image [N, 3, H, W]` in [-1, 1], H and W multiples of [`Vae::factor`], in one piece.
    pub fn encode(&self, image: &Array) -> Posterior {
        self.encode_by(image, &mut Statistics::Own)
    }

    fn encode_by(&self, image: &Array, statistics: &mut Statistics) -> Posterior {
        let hidden = self.encoder.forward(image, statistics);
        let moments = self
            .quant
            .as_ref()
            .map_or_else(|| hidden.clone(), |quant| quant.forward(&hidden));
        let latent = self.config.latent_channels;
        let logvar = clamp(&slice(&moments, 1, latent, latent), -30.0, 20.0);
        Posterior {
            mean: slice(&moments, 1, 0, latent),
            logvar,
        }
    }

    /// Decodes an unscaled `latent [N, C, h, w]` in one piece: `[N, 3, factor h, factor w]`, around
    /// [-1, 1].
    pub fn decode(&self, latent: &Array) -> Array {
        self.decode_by(latent, &mut Statistics::Own)
    }

    fn decode_by(&self, latent: &Array, statistics: &mut Statistics) -> Array {
        match &self.post_quant {
            Some(post_quant) => self
                .decoder
                .forward(&post_quant.forward(latent), statistics),
            None => self.decoder.forward(latent, statistics),
        }
    }

    /// Channels, height and width of the latent that [`Vae::encode_image`] makes of an image of this
    /// height and width.
    pub fn latent_shape(&self, size: [usize; 2]) -> [usize; 3] {
        let [height, width] = size.map(|extent| extent.div_ceil(self.factor()));
        [self.config.latent_channels, height, width]
    }

    /// The scaled latent `[N, C, ceil(H / factor), ceil(W / factor)]` of `image [N, 3, H, W]` in
    /// [-1, 1]: the posterior's mean times the scaling factor. The image is continued by reflection
    /// to whole latent pixels, and taken in overlapping tiles of `tile` image pixels if it is
    /// larger.
    pub fn encode_image(&self, image: &Array, tile: usize) -> Array {
        let factor = self.factor();
        let [height, width] = [image.shape()[2], image.shape()[3]];
        let image = continued(
            image,
            [height, width].map(|extent| extent.next_multiple_of(factor)),
        );
        // In latent pixels, so that a tile's border never cuts one in two.
        let tiling = Tiling::new(
            [height.div_ceil(factor), width.div_ceil(factor)],
            self.tile(tile),
        );
        let mean = each(&image, |image| {
            tiling.blend(1, |[top, left], [h, w], statistics| {
                let tile = crop(image, factor * top, factor * left, factor * h, factor * w);
                self.encode_by(&tile, statistics).mean
            })
        });
        // 0.08333 for the x4 upscaler. Stable Diffusion's usual 0.18215 would change the
        // brightness.
        scale(&mean, self.config.scaling_factor as f32)
    }

    /// The image `[N, 3, H, W]` of a scaled `latent`, where `[H, W]` = `size` is that of the image
    /// before it was encoded; in overlapping tiles of `tile` image pixels if it is larger.
    pub fn decode_latent(&self, latent: &Array, size: [usize; 2], tile: usize) -> Array {
        let latent = scale(latent, (1.0 / self.config.scaling_factor) as f32);
        let tiling = Tiling::new([latent.shape()[2], latent.shape()[3]], self.tile(tile));
        let image = each(&latent, |latent| {
            tiling.blend(self.factor(), |[top, left], [h, w], statistics| {
                self.decode_by(&crop(latent, top, left, h, w), statistics)
            })
        });
        // What `encode_image` added by reflection goes.
        crop(&image, 0, 0, size[0], size[1])
    }

    /// A tile's side in latent pixels.
    fn tile(&self, pixels: usize) -> usize {
        (pixels / self.factor()).max(MIN_TILE)
    }
}

/// What `compute` gives for each of N images, one after the other.
fn each(images: &Array, compute: impl Fn(&Array) -> Array) -> Array {
    // One image at a time, so that a tile bounds the memory and statistics never mix two images.
    let parts: Vec<Array> = (0..images.shape()[0])
        .map(|i| compute(&slice(images, 0, i, 1)))
        .collect();
    concat(&parts.iter().collect::<Vec<_>>(), 0)
}

/// An image continued by reflection, downwards and to the right, to the height and width `to`; at
/// once as far as it reaches, and again from there. What is one pixel wide is repeated.
fn continued(image: &Array, to: [usize; 2]) -> Array {
    let mut image = image.clone();
    let [height, width] = to;
    loop {
        let h = image.shape()[2];
        let w = image.shape()[3];
        // Reflection leaves the edge pixel out: n pixels can be continued by n - 1.
        let step = |extent: usize, to: usize| (to - extent).min(extent - 1);
        image = match (h, w) {
            _ if h == height && w == width => return image,
            (1, _) if h < height => concat(&[&image, &image], 2),
            (_, 1) if w < width => concat(&[&image, &image], 3),
            _ => pad_reflect(&image, [0, step(h, height), 0, step(w, width)]),
        };
    }
}

/// Attention layers of files from before diffusers 0.18 have other names.
fn current_name(name: &str) -> String {
    // The autoencoder has such parts of names in its attentions only.
    let renamed = [
        (".query.", ".to_q."),
        (".key.", ".to_k."),
        (".value.", ".to_v."),
        (".proj_attn.", ".to_out.0."),
    ];
    renamed
        .iter()
        .fold(name.to_owned(), |name, (old, new)| name.replace(old, new))
}
