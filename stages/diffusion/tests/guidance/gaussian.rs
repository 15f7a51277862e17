//! A diffusion prior with a closed form: the exact denoiser for latents drawn from N(mean, TAU^2),
//! element by element.

use std::cell::Cell;

use compute::elementwise::sub;
use compute::linear::{linear, linear_backward_weight};
use compute::{Array, Device, reduce};
use diffusion::guidance::Prompt;
use diffusion::optimize::{Denoiser, LoraParameters, Query, ViewLatents};
use diffusion::schedule::{Schedule, SchedulerConfig};

/// Standard deviation of the data.
const TAU: f64 = 0.1;

pub fn schedule() -> Schedule {
    let config = SchedulerConfig {
        beta_start: 1e-4,
        beta_end: 0.02,
        beta_schedule: "scaled_linear".into(),
        num_train_timesteps: 1000,
        prediction_type: "v_prediction".into(),
    };
    Schedule::new(&config, "scheduler_config.json").unwrap()
}

/// The denoiser. Its LoRA has one mean per view and element: column r is the mean for the camera
/// whose number r is 1.
pub struct Gaussian {
    device: Device,
    schedule: Schedule,
    positive: f32,
    negative: f32,
    /// Elements of a view.
    len: usize,
    /// How often the negative prompt was asked.
    pub asked_bad: Cell<u32>,
}

impl Gaussian {
    pub fn new(positive: f32, negative: f32, len: usize) -> Self {
        Self {
            device: Device::cpu(),
            schedule: schedule(),
            positive,
            negative,
            len,
            asked_bad: Cell::new(0),
        }
    }

    /// The factor k of E[x0 | z_t] = mean + k (z_t - a mean).
    fn gain(&self, t: u32) -> f64 {
        let a = self.schedule.a(t);
        let s = self.schedule.s(t);
        a * TAU * TAU / (a * a * TAU * TAU + s * s)
    }

    /// The exact velocity where element `i` of sample `n` has the given mean.
    fn exact(&self, query: &Query, mean: impl Fn(usize, usize) -> f32) -> Array {
        let noisy = query.noisy.to_vec();
        let per_sample = noisy.len() / query.t.len();
        let velocity = noisy.iter().enumerate().map(|(i, &noisy)| {
            let t = query.t[i / per_sample];
            let mean = f64::from(mean(i / per_sample, i % per_sample));
            let noisy = f64::from(noisy);
            let a = self.schedule.a(t);
            let s = self.schedule.s(t);
            let clean = mean + self.gain(t) * (noisy - a * mean);
            ((a * noisy - clean) / s) as f32
        });
        self.device.array(query.noisy.shape(), velocity.collect())
    }

    fn means(&self, cameras: &Array, lora: &LoraParameters) -> Array {
        linear(cameras, &lora["mean"], None)
    }
}

impl Denoiser for Gaussian {
    fn device(&self) -> &Device {
        &self.device
    }

    fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    fn low_schedule(&self) -> &Schedule {
        &self.schedule
    }

    fn max_noise_level(&self) -> u32 {
        350
    }

    fn velocities(&self, query: &Query, prompts: &[Prompt]) -> Vec<Array> {
        let velocity = |prompt: &Prompt| match prompt {
            Prompt::Positive => self.exact(query, |_, _| self.positive),
            Prompt::Negative => {
                self.asked_bad.set(self.asked_bad.get() + 1);
                self.exact(query, |_, _| self.negative)
            }
        };
        prompts.iter().map(velocity).collect()
    }

    fn new_lora(&self, _rank: u32, _seed: u64) -> LoraParameters {
        LoraParameters::from([(
            "mean".into(),
            self.device.full(&[self.len, 16], self.positive),
        )])
    }

    fn lora_velocity(&self, query: &Query, cameras: &Array, lora: &LoraParameters) -> Array {
        let means = self.means(cameras, lora).to_vec();
        self.exact(query, |sample, element| means[sample * self.len + element])
    }

    fn lora_gradients(
        &self,
        query: &Query,
        cameras: &Array,
        target: &Array,
        lora: &LoraParameters,
    ) -> (f64, LoraParameters) {
        let error = sub(&self.lora_velocity(query, cameras, lora), target);
        // dv / dmean = -(1 - k a) / s.
        let slope = |t: u32| -(1.0 - self.gain(t) * self.schedule.a(t)) / self.schedule.s(t);
        let by_mean = |(i, error): (usize, f32)| {
            2.0 * f64::from(error) * slope(query.t[i / self.len]) / target.len() as f64
        };
        let by_mean = error
            .to_vec()
            .into_iter()
            .enumerate()
            .map(|error| by_mean(error) as f32)
            .collect();
        let by_mean = self.device.array(&[query.t.len(), self.len], by_mean);
        let gradient = linear_backward_weight(cameras, &by_mean);
        (
            reduce::mean_square(&error).into(),
            LoraParameters::from([("mean".into(), gradient)]),
        )
    }
}

/// A view of height and width `size` whose camera is the unit vector of its number, with latents
/// spread around zero.
pub fn view(number: usize, size: [usize; 2]) -> ViewLatents {
    let [height, width] = size;
    let ramp = |i: usize| ((i * 7 + number * 3) % 11) as f32 / 11.0 - 0.5;
    let mut camera = [0.0; 16];
    camera[number] = 1.0;
    ViewLatents {
        name: format!("view_{number:03}"),
        latent: Device::cpu().array(
            &[2, height, width],
            (0..2 * height * width).map(ramp).collect(),
        ),
        low: Device::cpu().zeros(&[3, height, width]),
        mask: None,
        camera,
    }
}
