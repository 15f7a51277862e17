//! How a field is trained: the numbers, and the learning rate that follows from them. Knows nothing
//! of the training itself.

use crate::exposure::ExposureOptions;
use crate::poses::PoseOptions;
use serde::{Deserialize, Serialize};

/// How to train.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainOptions {
    /// Steps in all; the learning rate's schedule stretches over them.
    pub steps: u32,
    /// Samples along rays per step: the number of pixels in a batch follows from it.
    pub samples: u32,
    /// Adam's learning rate at its highest.
    pub rate: f64,
    /// The learning rate of the last step, as a part of `rate`; it falls exponentially over the
    /// second half of the steps.
    pub final_rate: f64,
    /// Steps over which the learning rate rises to `rate`.
    pub warm_up: u32,
    /// Where the loss turns from squared to absolute; at 1 it is half the squared error.
    pub beta: f64,
    /// Pull of the networks' weights towards zero; hash entries have none.
    pub l2: f64,
    /// Weight of the distortion loss, which draws the weights along a ray together.
    pub distortion: f64,
    /// Downward pull on raw densities near the cameras.
    pub fog: f64,
    /// The part of a ray's range that is near the camera in this sense.
    pub fog_range: f64,
    /// Put a random colour behind every pixel, of the field and of a transparent photo alike: holes
    /// in an opaque photo then cost as much as they let through. Otherwise the background is black.
    pub random_background: bool,
    /// Learn how each photo was exposed.
    pub exposure: Option<ExposureOptions>,
    /// Refine where each photo was taken from.
    pub poses: Option<PoseOptions>,
}

/// The part of the steps before the learning rate falls.
const HOLD: f64 = 0.5;

/// The rate was chosen by held-out PSNR (still life after 1500 steps: 24.46 dB at 0.01, 25.15 at
/// 0.03, 24.57 at 0.04 with a steeper fall; LLFF fern after 600: 23.29 at 0.01, 23.51 at 0.03); and
/// so was its fall, which is in `docs/lab/field.md`.
impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            steps: 2000,
            samples: 1 << 14,
            rate: 3e-2,
            final_rate: 0.2,
            warm_up: 50,
            beta: 1.0,
            l2: 1e-6,
            distortion: 1e-3,
            fog: 1e-4,
            fog_range: 0.05,
            random_background: true,
            exposure: None,
            poses: None,
        }
    }
}

impl TrainOptions {
    /// Whether anything is learnt beside the field, which only the CPU's trainer does.
    pub fn corrects_views(&self) -> bool {
        self.exposure.is_some() || self.poses.is_some()
    }

    /// The learning rate of the step after so many.
    pub(crate) fn rate_after(&self, steps: u32) -> f64 {
        // From 1/warm_up on, not from 0: the first step moves as well.
        let rise = f64::from(steps + 1) / f64::from(self.warm_up.max(1));
        let progress = f64::from(steps) / f64::from(self.steps.max(1));
        let fall = (progress.min(1.0) - HOLD).max(0.0) / (1.0 - HOLD);
        // Exponential: final_rate^0 = 1 up to HOLD, final_rate^1 at the last step.
        self.rate * rise.min(1.0) * self.final_rate.powf(fall)
    }
}
