//! Enlargement by a network: which one, and by how much. Knows no images on disk.

use std::path::PathBuf;

use artifacts_schema::Digest;
use compute::elementwise::clamp;
use compute::resize::{Filter, resize};
use compute::{Array, Device};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use upsampler::{Options, Upsampler, UpsamplerSource};

use crate::convert;
use crate::error::StageError;
use crate::model::Model;

/// A network as a filter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Learned {
    /// The network.
    pub model: Network,
    /// Whether the result is the mean over eight ways to turn and mirror the image; takes eight
    /// times as long.
    pub ensemble: bool,
    /// By how much images are reduced before the network enlarges them. 1 for photos, which are
    /// sharp at their pixels. More for blurred images: a network leaves blur as it finds it.
    #[schemars(range(min = 1, max = 16))]
    pub reduce: f64,
    /// Side of the tiles in pixels of the image; an image that fits in one is not tiled.
    #[schemars(range(min = 128, max = 8192))]
    pub tile: u32,
}

/// Which network.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Network {
    /// The small one that the binary carries.
    #[default]
    Embedded,
    /// A `.safetensors` file, or either file of an ncnn pair, `.param` and `.bin`.
    File(PathBuf),
}

impl Default for Learned {
    fn default() -> Self {
        Self {
            model: Network::default(),
            ensemble: false,
            reduce: 1.0,
            tile: 256,
        }
    }
}

/// Bytes that a network's layers take for each pixel of a tile, roughly: small ones at the image's
/// size, and large ones that also work at the result's.
const SMALL: u64 = 4 << 10;
const LARGE: u64 = 14 << 10;

impl Learned {
    /// Refuses parameters that make no sense.
    pub fn check(&self) -> Result<(), StageError> {
        convert::number_in_range("filter.reduce", self.reduce, 1.0, 16.0)?;
        convert::in_range("filter.tile", self.tile, 128, 8192)
    }

    /// The network, on this device.
    pub fn load(&self, device: &Device) -> Result<Upsampler, StageError> {
        Ok(Upsampler::load(&self.source(), device)?)
    }

    /// `image [1, 3, H, W]`, from 0 to 1, at another size: reduced if it is to be, enlarged by the
    /// network as often as it takes, at least once, and resized if that is not the size yet.
    pub fn resize(&self, network: &Upsampler, image: &Array, [height, width]: [usize; 2]) -> Array {
        let options = Options {
            tile: self.tile as usize,
            ensemble: self.ensemble,
        };
        // Networks overshoot, and the next pass was trained on 0 to 1.
        let enlarge = |image: &Array| clamp(&network.enlarge(image, options), 0.0, 1.0);
        // Once in any case: to a size that is there already, too, the network has something to add.
        let mut image = enlarge(&self.reduced(image));
        // A network for x1 enlarges nothing, and would loop for ever.
        while network.scale() > 1 && (image.shape()[2] < height || image.shape()[3] < width) {
            image = enlarge(&image);
        }
        match image.shape()[2..] == [height, width] {
            true => image,
            false => clamp(
                &resize(&image, height, width, Filter::BicubicTorch, true),
                0.0,
                1.0,
            ),
        }
    }

    /// The image as the network gets it, by the filter that made the small images of its training.
    fn reduced(&self, image: &Array) -> Array {
        if self.reduce == 1.0 {
            return image.clone();
        }
        let [height, width] = [2, 3].map(|axis| {
            let side = image.shape()[axis] as f64 / self.reduce;
            side.round().max(1.0) as usize
        });
        let small = resize(image, height, width, Filter::BicubicPil, true);
        clamp(&small, 0.0, 1.0)
    }

    /// Bytes of memory for its weights and for one tile, and seconds for so many pixels, roughly.
    pub fn cost(&self, pixels: u64) -> (u64, f64) {
        let weights = |path: &PathBuf| path.metadata().map_or(0, |file| file.len());
        // The embedded network has no file, and files may be gone by now: an estimate must not be
        // 0.
        let bytes = self
            .source()
            .paths()
            .iter()
            .map(weights)
            .sum::<u64>()
            .max(1 << 20);
        // Large files are of networks that double their images before the last layers.
        let each = if bytes > 8 << 20 { LARGE } else { SMALL };
        let ways = if self.ensemble { 8.0 } else { 1.0 };
        let reduced = pixels as f64 / (self.reduce * self.reduce);
        let operations = ways * bytes as f64 * reduced;
        (
            2 * bytes + each * u64::from(self.tile) * u64::from(self.tile),
            operations / 4e10,
        )
    }

    fn source(&self) -> UpsamplerSource {
        match &self.model {
            Network::Embedded => UpsamplerSource::Embedded,
            Network::File(path) => UpsamplerSource::File(path.clone()),
        }
    }
}

impl Model for Learned {
    fn locations(&self) -> &'static [&'static str] {
        &["filter.model"]
    }

    fn content(&self) -> Result<Digest, StageError> {
        let source = self.source();
        let digest = Digest::new(source.digest()?);
        // A file that is no network is refused before anything runs: what comes before this stage
        // may take hours. This is asked anew only where the file has changed.
        if source != UpsamplerSource::Embedded {
            Upsampler::load(&source, &Device::cpu())?;
        }
        Ok(digest)
    }

    fn files(&self) -> Option<Vec<PathBuf>> {
        Some(self.source().paths())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::back_projection::back_project;

    fn image() -> Array {
        Device::cpu().array(
            &[1, 3, 9, 12],
            (0..324)
                .map(|i| 0.5 + 0.4 * (i as f32 * 0.7).sin())
                .collect(),
        )
    }

    #[test]
    fn any_size_is_reached() {
        let learned = Learned::default();
        let image = image();
        let network = learned.load(&Device::cpu()).unwrap();
        for size in [[36, 48], [18, 24], [9, 12], [5, 6], [37, 50], [150, 200]] {
            let resized = learned.resize(&network, &image, size);
            assert_eq!(resized.shape(), [1, 3, size[0], size[1]]);
            assert!(resized.to_vec().iter().all(|x| (0.0..=1.0).contains(x)));
        }
    }

    /// A disc 30 pixels across, and the same disc blurred, `[1, 3, 40, 40]` each.
    fn discs() -> [Array; 2] {
        let value = |i: usize| {
            let [y, x] = [i % 1600 / 40, i % 40].map(|at| at as f32 - 19.5);
            0.2 + 0.6 * (15.5 - (x * x + y * y).sqrt()).clamp(0.0, 1.0)
        };
        let sharp = Device::cpu().array(&[1, 3, 40, 40], (0..4800).map(value).collect());
        let small = resize(&sharp, 16, 16, Filter::BicubicPil, true);
        let blurred = resize(&small, 40, 40, Filter::BicubicTorch, false);
        [sharp, blurred]
    }

    #[test]
    fn a_picture_that_is_reduced_first_comes_out_sharper() {
        let [sharp, blurred] = discs();
        let network = Learned::default().load(&Device::cpu()).unwrap();
        let error = |image: &Array| {
            let pairs = image.to_vec().into_iter().zip(sharp.to_vec());
            pairs.map(|(a, b)| (a - b) * (a - b)).sum::<f32>()
        };
        let resized = |reduce: f64| {
            let learned = Learned {
                reduce,
                ..Learned::default()
            };
            error(&learned.resize(&network, &blurred, [40, 40]))
        };
        let [as_it_is, reduced] = [1.0, 2.5].map(resized);
        let before = error(&blurred);
        assert!(reduced < 0.7 * before, "{reduced} and {before}");
        assert!(reduced < 0.7 * as_it_is, "{reduced} and {as_it_is}");
    }

    #[test]
    fn a_reduction_outside_its_range_is_refused() {
        for reduce in [0.5, f64::NAN, 17.0] {
            let learned = Learned {
                reduce,
                ..Learned::default()
            };
            assert_eq!(
                learned.check().unwrap_err().to_string(),
                format!("`filter.reduce` is {reduce}; it must be 1 to 16")
            );
        }
    }

    #[test]
    fn back_projection_brings_the_result_in_line_with_the_image() {
        let learned = Learned::default();
        let image = image();
        let large = learned.resize(&learned.load(&Device::cpu()).unwrap(), &image, [36, 48]);
        let error = |large: &Array| {
            let reduced = resize(large, 9, 12, Filter::BicubicPil, true);
            reduced
                .to_vec()
                .iter()
                .zip(image.to_vec())
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max)
        };
        let rounds = |count| back_project(large.clone(), &image, None, count, [0.0, 1.0]);
        assert_eq!(rounds(0).to_vec(), large.to_vec());
        assert!(
            error(&rounds(5)) < 0.3 * error(&large),
            "{} and {}",
            error(&rounds(5)),
            error(&large)
        );
    }
}
