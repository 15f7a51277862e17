//! Training on whatever device was chosen. Knows which trainers there are, and nothing of what they
//! do.

use crate::batch::TrainView;
use crate::config::FieldConfig;
use crate::exposure::Exposure;
use crate::field::Field;
use crate::gpu::GpuTrainer;
use crate::options::TrainOptions;
use crate::tensors::{FieldError, Tensors};
use crate::train::{StepStats, Trainer};
use compute::Device;
use formats::Camera;

/// A field in training on a device.
pub enum Training {
    /// By threads of the CPU.
    Cpu(Box<Trainer>),
    /// By the kernels of an adapter.
    Gpu(Box<GpuTrainer>),
}

impl Training {
    /// Starts training of a field; see [`Trainer::new`].
    pub fn new(
        device: &Device,
        field: Field,
        views: Vec<TrainView>,
        options: &TrainOptions,
        seed: u64,
    ) -> Self {
        // The CPU's trainer prepares both: grids, batches' sizes and refused views are alike.
        Self::on(device, Trainer::new(field, views, options, seed))
    }

    /// Goes on from [`Training::state`], be it of this device or another; see
    /// [`Trainer::from_state`].
    pub fn from_state(
        device: &Device,
        config: &FieldConfig,
        bounds: [[f32; 3]; 2],
        views: Vec<TrainView>,
        options: &TrainOptions,
        seed: u64,
        state: &Tensors,
    ) -> Result<Self, FieldError> {
        Ok(Self::on(
            device,
            Trainer::from_state(config, bounds, views, options, seed, state)?,
        ))
    }

    /// What is learnt about views is learnt by threads, whatever the device.
    fn on(device: &Device, trainer: Trainer) -> Self {
        let gpu = device.open_gpu();
        match gpu.filter(|_| !trainer.options.corrects_views()) {
            None => Self::Cpu(Box::new(trainer)),
            Some(gpu) => Self::Gpu(Box::new(GpuTrainer::new(gpu, trainer))),
        }
    }

    /// Steps taken so far.
    pub fn steps_taken(&self) -> u32 {
        match self {
            Self::Cpu(trainer) => trainer.steps_taken(),
            Self::Gpu(trainer) => trainer.steps_taken(),
        }
    }

    /// The cameras of the views, in their order, as they are now.
    pub fn cameras(&self) -> Vec<Camera> {
        match self {
            Self::Cpu(trainer) => trainer.cameras(),
            Self::Gpu(trainer) => trainer.host.cameras(),
        }
    }

    /// How the views were exposed, in their order; `None` where that is not learnt.
    pub fn exposures(&self) -> Option<Vec<Exposure>> {
        match self {
            Self::Cpu(trainer) => trainer.exposures(),
            Self::Gpu(_) => None,
        }
    }

    /// One training step. If the loss is not a finite number, nothing is learnt from it: the field
    /// stays as it was.
    pub fn step(&mut self) -> StepStats {
        match self {
            Self::Cpu(trainer) => trainer.step(),
            Self::Gpu(trainer) => trainer.step(),
        }
    }

    /// Everything that the coming steps depend on; see [`Trainer::state`].
    pub fn state(&mut self) -> Tensors {
        match self {
            Self::Cpu(trainer) => trainer.state(),
            Self::Gpu(trainer) => trainer.state(),
        }
    }

    /// Ends training. From a GPU the field is read back.
    pub fn into_field(self) -> Field {
        match self {
            Self::Cpu(trainer) => trainer.into_field(),
            Self::Gpu(trainer) => trainer.into_field(),
        }
    }
}
