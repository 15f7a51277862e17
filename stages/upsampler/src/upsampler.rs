//! An upsampler of whatever family, read whole and ready to enlarge images.

use std::collections::BTreeMap;

use compute::{Array, Device};
use formats::FileBytes;

use crate::error::UpsamplerError;
use crate::network::Network;
use crate::source::UpsamplerSource;
use crate::tensors::Tensors;
use crate::{ensemble, family, ncnn, tiles};

/// How images are enlarged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// The side of the windows in which a large image is taken, in its pixels.
    pub tile: usize,
    /// Whether the result is the mean over eight ways to turn and mirror the image.
    pub ensemble: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            tile: 256,
            ensemble: false,
        }
    }
}

/// What a network is made of.
#[derive(Clone, Debug)]
pub struct Inventory {
    /// The architecture, as `model check` prints it: `SPAN`.
    pub family: &'static str,
    /// The result's side over the image's.
    pub scale: usize,
    /// Channels between its layers, at the most.
    pub width: usize,
    /// Blocks or convolutions, in words.
    pub depth: String,
    /// How many pixels away an input may be from those that it changes.
    pub reach: usize,
    /// The margin of a window around what is kept of it.
    pub margin: usize,
    /// How many tensors its files hold.
    pub tensors: usize,
    /// How many numbers those are.
    pub parameters: usize,
    /// For each number type that the files use, how many.
    pub types: BTreeMap<String, usize>,
}

/// A network that enlarges images.
pub struct Upsampler {
    network: Box<dyn Network>,
    device: Device,
    types: BTreeMap<String, usize>,
    tensors: usize,
}

impl Upsampler {
    /// Reads a network whole. The error names the file, and the tensor or layer in it, that cannot
    /// be used.
    pub fn load(source: &UpsamplerSource, device: &Device) -> Result<Self, UpsamplerError> {
        let mut files = source.files()?.into_iter();
        // `files` gives an ncnn pair as graph and weights, in this order.
        match (files.next(), files.next()) {
            (Some(graph), Some(weights)) => Self::from_ncnn(&graph, &weights, device),
            (Some(file), None) => Self::from_safetensors(file, device),
            (None, _) => Err(UpsamplerError::file("", "there is no file")),
        }
    }

    /// The network of a safetensors file.
    pub fn from_safetensors(file: FileBytes, device: &Device) -> Result<Self, UpsamplerError> {
        let mut tensors = Tensors::open(file, device)?;
        let network = family::recognise(&mut tensors)?;
        let types = tensors.counts();
        let count = tensors.names().count();
        Ok(Self {
            network,
            device: device.clone(),
            types,
            tensors: count,
        })
    }

    /// The network of an ncnn pair: `.param` and `.bin`.
    pub fn from_ncnn(
        graph: &FileBytes,
        weights: &FileBytes,
        device: &Device,
    ) -> Result<Self, UpsamplerError> {
        let (network, types, tensors) = ncnn::read(graph, weights, device)?;
        Ok(Self {
            network,
            device: device.clone(),
            types,
            tensors,
        })
    }

    /// The result's side over the image's.
    pub fn scale(&self) -> usize {
        self.network.facts().scale
    }

    /// What it is made of.
    pub fn inventory(&self) -> Inventory {
        let facts = self.network.facts();
        Inventory {
            margin: tiles::margin(&facts),
            family: facts.family,
            scale: facts.scale,
            width: facts.width,
            depth: facts.depth,
            reach: facts.reach,
            tensors: self.tensors,
            parameters: self.types.values().sum(),
            types: self.types.clone(),
        }
    }

    /// Bytes that the weights take, and what lies between the layers for one window of `tile` by
    /// `tile`, roughly.
    pub fn memory(&self, tile: usize) -> [u64; 2] {
        let parameters: usize = self.types.values().sum();
        [
            // All are widened to 32 bits when they are read.
            4 * parameters as u64,
            // A tile has its margins within it, so its area is what a pass sees.
            (self.network.facts().bytes_per_pixel * tile * tile) as u64,
        ]
    }

    /// `x [N, 3, H, W]`, 0 to 1, enlarged: `[N, 3, H scale, W scale]`, which may go somewhat
    /// beyond. Panics where `x` has another shape, or is empty.
    pub fn enlarge(&self, x: &Array, options: Options) -> Array {
        assert!(
            matches!(*x.shape(), [n, 3, h, w] if n * h * w > 0),
            "enlarge: {:?} are no images",
            x.shape()
        );
        assert_eq!(
            *x.device(),
            self.device,
            "enlarge: the image lies on another device than the network"
        );
        // The ensemble is outside the tiles: its eight images are taken in windows of their own.
        let enlarge = |x: &Array| tiles::enlarge(&*self.network, x, options.tile);
        if options.ensemble {
            ensemble::mean(x, enlarge)
        } else {
            enlarge(x)
        }
    }
}
