//! LPIPS, how far apart two pictures are to a network that was trained to name what pictures show
//! (Zhang et al. 2018, <https://doi.org/10.1109/CVPR.2018.00068>), and its shift-tolerant kin
//! ST-LPIPS (Ghildyal and Liu 2022). Knows no weights: they come as a file.
//!
//! Both pictures go through a trunk. After each of its slices the channels of a pixel are scaled to
//! length 1; squared differences are weighted by channel, averaged over pixels, and added up.

mod network;
mod pool;
mod trunk;

use compute::{Array, Device};
use formats::FileBytes;
use formats::tensor_file::{TensorError, TensorFile};
use rayon::prelude::*;

use crate::Image;
use network::{NETWORKS, Network};
use trunk::Trunk;

/// What is taken off a channel from -1 to 1, and what it is divided by: the mean and the deviation
/// of ImageNet's photos (version 0.1; version 0.0 forgot them).
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Keeps a pixel without any activation from being divided by 0.
const EPSILON: f64 = 1e-10;
/// The least side of a picture of which every slice has a pixel.
const LEAST_SIDE: usize = 32;

/// Why a file of weights cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LpipsError {
    /// It is not the state of a network that is known here.
    #[error(
        "{file}: holds no LPIPS network: neither alex, vgg or squeeze of the package `lpips`, nor alex or vgg of \
         `stlpips-pytorch`, trunk and heads together (docs/metrics.md says how such a file is made)"
    )]
    Unknown {
        /// The path of the file.
        file: String,
    },
    /// A tensor is missing or not as the network has it.
    #[error(transparent)]
    Tensor(#[from] TensorError),
}

/// A network with its heads.
pub struct Lpips {
    network: &'static Network,
    trunk: Trunk,
    /// By slice: how much each channel counts.
    heads: Vec<Vec<f32>>,
}

impl Lpips {
    /// The network whose state, trunk and heads, is in a safetensors file.
    pub fn open(file: FileBytes) -> Result<Self, LpipsError> {
        let file = TensorFile::new(file)?;
        let known = NETWORKS.iter();
        let network = known
            .into_iter()
            // By a tensor's name, not by the file's: files are called what their owners like.
            .find(|network| file.entry(network.sign).is_ok())
            .ok_or_else(|| LpipsError::Unknown {
                file: file.name().to_owned(),
            })?;
        // On the CPU, so that figures of fields from different devices compare.
        let device = Device::cpu();
        let trunk = Trunk::read(network, &file, &device)?;
        let heads = trunk.channels.iter().enumerate();
        let heads = heads
            .map(|(slice, &channels)| {
                // A head of the package is a dropout layer, number 0, and a 1x1 convolution.
                let name = format!("lin{slice}.model.1.weight");
                trunk::tensor(&file, &name, &[1, channels, 1, 1])
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            network,
            trunk,
            heads,
        })
    }

    /// The column's name: `lpips_alex`, `stlpips_vgg` and so on.
    pub fn name(&self) -> &'static str {
        self.network.name
    }

    /// The distance of `image` from `truth`: 0 for identical pictures; symmetric. `None` if a side
    /// is below 32 pixels. Panics if the sizes differ.
    pub fn distance(&self, truth: Image, image: Image) -> Option<f64> {
        truth.assert_same_size(&image, "lpips");
        if truth.width().min(truth.height()) < LEAST_SIDE {
            return None;
        }
        let [truth, image] = [truth, image].map(|picture| self.trunk.slices(&input(picture)));
        let slices = truth.iter().zip(&image).zip(&self.heads);
        Some(slices.map(|((a, b), head)| apart(a, b, head)).sum())
    }
}

/// A picture as the trunks take it: `[1, 3, H, W]`.
fn input(picture: Image) -> Array {
    let plane = |channel: usize| {
        let values = picture.clamped().skip(channel).step_by(3);
        // First to -1..1, the range that SHIFT and SCALE are meant for.
        values.map(move |value| (2.0 * value - 1.0 - SHIFT[channel]) / SCALE[channel])
    };
    let shape = [1, 3, picture.height(), picture.width()];
    Device::cpu().array(&shape, (0..3).flat_map(plane).collect())
}

/// How far apart two slices' outputs `[1, C, h, w]` are: the mean over pixels of the weighted
/// squared differences.
fn apart(a: &Array, b: &Array, head: &[f32]) -> f64 {
    let plane = a.shape()[2] * a.shape()[3];
    let [a, b] = [a.to_vec(), b.to_vec()];
    let [scale_a, scale_b] = [&a, &b].map(|values| scales(values, plane));
    let channel = |((a, b), weight): ((&[f32], &[f32]), &f32)| {
        let pixels = a.iter().zip(b).zip(scale_a.iter().zip(&scale_b));
        // In f64: for similar pictures the two terms nearly cancel.
        let squares = pixels.map(|((a, b), (scale_a, scale_b))| {
            (f64::from(*a) * scale_a - f64::from(*b) * scale_b).powi(2)
        });
        f64::from(*weight) * squares.sum::<f64>()
    };
    let channels = a.par_chunks(plane).zip(b.par_chunks(plane)).zip(head);
    // Collected before they are added up, so that the sum has one order.
    let sums: Vec<f64> = channels.map(channel).collect();
    sums.iter().sum::<f64>() / plane as f64
}

/// For each pixel, what brings its channels to length 1.
fn scales(values: &[f32], plane: usize) -> Vec<f64> {
    let mut squares = vec![0.0; plane];
    for channel in values.chunks(plane) {
        for (sum, value) in squares.iter_mut().zip(channel) {
            *sum += f64::from(*value).powi(2);
        }
    }
    // The package adds EPSILON to the length, not to the square under the root.
    let scale = |square: f64| 1.0 / (square.sqrt() + EPSILON);
    squares.into_iter().map(scale).collect()
}
