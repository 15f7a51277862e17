//! What the optimisation asks of a diffusion model. Knows no network: tests put closed formulas in
//! its place.

use std::collections::BTreeMap;

use compute::{Array, Device};

use crate::guidance::Prompt;
use crate::schedule::Schedule;

/// The trainable parameters of a LoRA and its camera embedding, or gradients or moments of them, by
/// name.
pub type LoraParameters = BTreeMap<String, Array>;

/// A batch of N noised latents that a network is asked about.
#[derive(Clone, Copy, Debug)]
pub struct Query<'a> {
    /// The noised latents `[N, C, h, w]`, in scaled latent units.
    pub noisy: &'a Array,
    /// The noised low-resolution images `[N, 3, h, w]` in [-1, 1].
    pub low: &'a Array,
    /// The latents' timesteps, one for each of the N.
    pub t: &'a [u32],
    /// The low-resolution images' timestep, which the network takes as class label.
    pub noise_level: u32,
}

/// A latent upscaler, and the LoRA of it that variational score distillation trains. Velocities are
/// `[N, C, h, w]`.
pub trait Denoiser {
    /// The device that it computes on, where the latents have to lie.
    fn device(&self) -> &Device;

    /// The noise schedule of the latents.
    fn schedule(&self) -> &Schedule;

    /// The noise schedule of the low-resolution images.
    fn low_schedule(&self) -> &Schedule;

    /// The most noise, as a timestep of [`Denoiser::low_schedule`], that the low-resolution images
    /// may have.
    fn max_noise_level(&self) -> u32;

    /// The prior's velocity for each of the prompts.
    fn velocities(&self, query: &Query, prompts: &[Prompt]) -> Vec<Array>;

    /// The parameters of a LoRA that changes nothing yet.
    fn new_lora(&self, rank: u32, seed: u64) -> LoraParameters;

    /// The velocity of the network with a LoRA and one camera per sample, `[N, 16]`; all zero
    /// stands for no camera.
    fn lora_velocity(&self, query: &Query, cameras: &Array, lora: &LoraParameters) -> Array;

    /// The mean squared difference between that velocity and `target`, and its gradient by every
    /// parameter.
    fn lora_gradients(
        &self,
        query: &Query,
        cameras: &Array,
        target: &Array,
        lora: &LoraParameters,
    ) -> (f64, LoraParameters);
}
