//! Low-rank adapters of the UNet's attention (Hu et al. 2021, equation 3) and the camera embedding
//! that is trained with them.
//!
//! Holds tensors by name; knows neither the layers they belong to nor how they are trained.

use std::collections::BTreeMap;

use compute::{Array, Device, Rng};

use crate::error::ModelError;

/// Numbers that describe a camera: a 4x4 matrix, row by row.
pub const CAMERA_NUMBERS: usize = 16;

/// The trainable part of a network: what a frozen UNet becomes another one with. A layer without an
/// adapter stays as it is.
#[derive(Clone, Debug)]
pub struct LoraNetwork {
    /// What an adapter's product is multiplied by: alpha / r.
    pub scale: f32,
    /// Scales of layers where it is another number, by the name of their matrix A.
    pub scales: BTreeMap<String, f32>,
    /// `unet.<layer>.lora_A.weight` `[r, inputs]` and `unet.<layer>.lora_B.weight` `[outputs, r]`,
    /// named as PEFT names them.
    pub adapters: BTreeMap<String, Array>,
    /// The camera embedding, 16 numbers -> D -> SiLU -> D, D the width of the time embedding to
    /// which it is added: `camera_embedding.linear_1.weight` `[D, 16]`, `.bias` `[D]`,
    /// `camera_embedding.linear_2.weight` `[D, D]`, `.bias` `[D]`.
    pub camera: BTreeMap<String, Array>,
}

/// Gradients of a loss by the tensors of a [`LoraNetwork`], under the same names.
#[derive(Clone, Debug, Default)]
pub struct LoraGradients {
    /// By the adapters, under their names.
    pub adapters: BTreeMap<String, Array>,
    /// By the camera embedding; empty if the forward pass had no camera.
    pub camera: BTreeMap<String, Array>,
    /// By the UNet's input `[N, C, h, w]`, if it was asked for.
    pub sample: Option<Array>,
}

/// Names and sizes of one adapter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct AdapterSite {
    /// Name of the matrix A, which reduces.
    pub down: String,
    /// Name of the matrix B, which expands.
    pub up: String,
    pub inputs: usize,
    pub outputs: usize,
}

impl AdapterSite {
    pub fn new(layer: &str, inputs: usize, outputs: usize) -> Self {
        let name = |matrix| format!("unet.{layer}.lora_{matrix}.weight");
        Self {
            down: name("A"),
            up: name("B"),
            inputs,
            outputs,
        }
    }

    /// The path of the layer.
    pub fn layer(&self) -> Option<&str> {
        self.down
            .strip_prefix("unet.")?
            .strip_suffix(".lora_A.weight")
    }
}

pub(crate) const CAMERA_1: &str = "camera_embedding.linear_1";
pub(crate) const CAMERA_2: &str = "camera_embedding.linear_2";

impl LoraNetwork {
    /// A network that computes exactly what the frozen one does: A is normal with standard
    /// deviation 1/r, B and the camera embedding's last layer are zero.
    pub(crate) fn new(
        sites: &[AdapterSite],
        width: usize,
        rank: usize,
        alpha: f64,
        seed: u64,
        device: &Device,
    ) -> Self {
        let rng = Rng::new(seed, "lora");
        let mut adapters = BTreeMap::new();
        for (step, site) in sites.iter().enumerate() {
            // Every matrix has a step of the stream to itself, so no two of one shape are equal.
            let normals = rng.normals(step as u64, &[rank, site.inputs], device);
            adapters.insert(
                site.down.clone(),
                // 1/r, as diffusers initialises; B is zero, so the product starts at zero all the
                // same.
                compute::elementwise::scale(&normals, 1.0 / rank as f32),
            );
            adapters.insert(site.up.clone(), device.zeros(&[site.outputs, rank]));
        }
        let camera = camera_embedding(width, seed, device);
        Self {
            scale: (alpha / rank as f64) as f32,
            scales: BTreeMap::new(),
            adapters,
            camera,
        }
    }

    /// What the product of a layer's adapter is multiplied by.
    pub(crate) fn scale(&self, site: &AdapterSite) -> f32 {
        self.scales.get(&site.down).copied().unwrap_or(self.scale)
    }

    /// The matrices A and B of one layer, if it is adapted.
    pub(crate) fn adapter(&self, site: &AdapterSite) -> Option<(&Array, &Array)> {
        Some((self.adapters.get(&site.down)?, self.adapters.get(&site.up)?))
    }

    /// Fails if a tensor belongs to no layer, has another shape than its layer needs or lacks its
    /// partner; `file` is where they came from. There may be no camera embedding; if there is one,
    /// it is whole.
    pub(crate) fn check(
        &self,
        sites: &[AdapterSite],
        width: usize,
        file: &str,
    ) -> Result<(), ModelError> {
        // Files are foreign: a tensor under a wrong name would take no part, and nobody would
        // notice.
        let by_name: BTreeMap<&str, &AdapterSite> = sites
            .iter()
            .flat_map(|site| [(site.down.as_str(), site), (site.up.as_str(), site)])
            .collect();
        for (name, tensor) in &self.adapters {
            match by_name.get(name.as_str()) {
                Some(site) => self.check_adapter(site, name, tensor, file)?,
                None => {
                    return Err(ModelError::tensor(
                        file,
                        name,
                        "belongs to no attention of this model",
                    ));
                }
            }
        }
        // Files from elsewhere adapt the attentions only.
        let camera = if self.camera.is_empty() {
            BTreeMap::new()
        } else {
            camera_shapes(width)
        };
        if let Some(name) = self.camera.keys().find(|name| !camera.contains_key(*name)) {
            return Err(ModelError::tensor(
                file,
                name,
                "belongs to no camera embedding",
            ));
        }
        camera
            .iter()
            .try_for_each(|(name, shape)| match self.camera.get(name) {
                Some(tensor) => check_shape(tensor, shape, name, file),
                None => Err(ModelError::tensor(file, name, "is missing")),
            })
    }

    fn check_adapter(
        &self,
        site: &AdapterSite,
        name: &str,
        tensor: &Array,
        file: &str,
    ) -> Result<(), ModelError> {
        let partner = if name == site.down {
            &site.up
        } else {
            &site.down
        };
        if !self.adapters.contains_key(partner) {
            return Err(ModelError::tensor(file, partner, "is missing"));
        }
        let rank = match (name == site.down, tensor.shape()) {
            (true, [rank, _]) | (false, [_, rank]) => *rank,
            (_, shape) => {
                return Err(ModelError::tensor(
                    file,
                    name,
                    format!("has the shape {shape:?}; an adapter is a matrix"),
                ));
            }
        };
        // The rank may differ between layers, but not between the two matrices of one.
        let down = self
            .adapters
            .get(&site.down)
            .map_or(rank, |down| down.shape()[0]);
        let shape = if name == site.down {
            [rank, site.inputs]
        } else {
            [site.outputs, down]
        };
        check_shape(tensor, &shape, name, file)
    }
}

fn check_shape(tensor: &Array, shape: &[usize], name: &str, file: &str) -> Result<(), ModelError> {
    if tensor.shape() == shape {
        return Ok(());
    }
    Err(ModelError::tensor(
        file,
        name,
        format!(
            "has the shape {:?}; this model needs {shape:?}",
            tensor.shape()
        ),
    ))
}

fn camera_shapes(width: usize) -> BTreeMap<String, Vec<usize>> {
    BTreeMap::from([
        (format!("{CAMERA_1}.weight"), vec![width, CAMERA_NUMBERS]),
        (format!("{CAMERA_1}.bias"), vec![width]),
        (format!("{CAMERA_2}.weight"), vec![width, width]),
        (format!("{CAMERA_2}.bias"), vec![width]),
    ])
}

/// The first layer uniform within 1/sqrt(16), as PyTorch initialises a linear layer; the second
/// zero.
fn camera_embedding(width: usize, seed: u64, device: &Device) -> BTreeMap<String, Array> {
    let rng = Rng::new(seed, "camera_embedding");
    let bound = 1.0 / (CAMERA_NUMBERS as f32).sqrt();
    let tensor = |(step, (name, shape)): (usize, (String, Vec<usize>))| {
        let values =
            (0..shape.iter().product::<usize>()).map(|i| match name.starts_with(CAMERA_1) {
                true => bound * (2.0 * rng.uniform(step as u64, i as u64) - 1.0),
                false => 0.0,
            });
        (name.clone(), device.array(&shape, values.collect()))
    };
    camera_shapes(width)
        .into_iter()
        .enumerate()
        .map(tensor)
        .collect()
}
