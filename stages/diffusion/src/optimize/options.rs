//! The options of the optimisation stage and their defaults. Knows no pipeline file.

use compute::adam::Adam;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::guidance::{Guidance, InvalidOption, Loss, Vsd, at_least_one, decay, positive};

/// Options of the optimisation of residual latents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// The rule to follow, with its own options.
    pub guidance: Guidance,
    /// Guidance steps in all.
    #[schemars(range(min = 1))]
    pub steps: u32,
    /// Views in each step; all of them, where there are fewer.
    #[schemars(range(min = 1))]
    pub batch: u32,
    /// How a residual descends its gradient.
    pub optimizer: Optimizer,
    /// How the direction becomes a gradient.
    pub loss: Loss,
    /// Scale of classifier-free guidance; at 1 the negative prompt is not asked.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub guidance_scale: f64,
    /// Height and width of the crops that a step looks at, in latent pixels; less where a view is
    /// smaller.
    #[schemars(range(min = 1))]
    pub crop: u32,
    /// The timestep to which the low-resolution image is noised.
    pub noise_level: u32,
    /// What the pictures should be.
    pub prompt: String,
    /// What they should not be.
    pub negative_prompt: String,
}

/// How a residual descends its gradient; the step size comes with the guidance rule.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum Optimizer {
    /// Adam without weight decay.
    Adam(Moments),
    /// Plain gradient descent.
    Sgd,
}

/// The constants of Adam.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Moments {
    /// Decay of the first moment.
    #[schemars(range(min = 0), extend("exclusiveMaximum" = 1))]
    pub beta1: f64,
    /// Decay of the second moment.
    #[schemars(range(min = 0), extend("exclusiveMaximum" = 1))]
    pub beta2: f64,
    /// Gradients well below it keep their size; those well above become steps of the full rate.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub eps: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            guidance: Guidance::Vsd(Vsd::default()),
            // The paper's count, and DiSR-NeRF's batch.
            steps: 2000,
            batch: 16,
            optimizer: Optimizer::default(),
            loss: Loss::L2,
            guidance_scale: 1.0,
            // 512 image pixels, the size of the crops that the x4 upscaler was trained on.
            crop: 128,
            // diffusers' default for the x4 upscaler.
            noise_level: 20,
            prompt: "high resolution, 4K, photo".into(),
            negative_prompt: "blurry, low quality".into(),
        }
    }
}

impl Default for Optimizer {
    fn default() -> Self {
        Self::Adam(Moments::default())
    }
}

impl Default for Moments {
    /// DiSR-NeRF's decays. Its eps of 1e-15 makes a step of the full rate of any direction, however
    /// small, and so turns steady small ones into drift; 0.1 is the size of the rules' directions
    /// on latents of unit variance.
    fn default() -> Self {
        Self {
            beta1: 0.9,
            beta2: 0.99,
            eps: 0.1,
        }
    }
}

impl Options {
    /// Refuses numbers that make no sense, by field.
    pub fn check(&self) -> Result<(), InvalidOption> {
        self.guidance.rule().check()?;
        at_least_one("steps", self.steps)?;
        at_least_one("batch", self.batch)?;
        self.optimizer.check()?;
        positive("guidance_scale", self.guidance_scale)?;
        at_least_one("crop", self.crop)
    }

    /// Steps of the LoRA alone before the first guidance step.
    pub fn warm_up(&self) -> u32 {
        self.guidance.rule().lora().map_or(0, |lora| lora.warm_up)
    }
}

impl Optimizer {
    fn check(&self) -> Result<(), InvalidOption> {
        let Self::Adam(moments) = self else {
            return Ok(());
        };
        decay("optimizer.beta1", moments.beta1)?;
        decay("optimizer.beta2", moments.beta2)?;
        positive("optimizer.eps", moments.eps)
    }
}

/// The LoRA's optimiser: AdamW with PyTorch's defaults, at the rule's rate.
pub(super) fn lora_adam(rate: f64) -> Adam {
    Adam {
        rate: rate as f32,
        beta1: 0.9,
        beta2: 0.999,
        eps: 1e-8,
        weight_decay: 0.01,
    }
}
