//! The noise schedule: how much of a latent and how much noise there is at each timestep, and the
//! conversions between what a network predicts and what it means. Knows no network and no guidance
//! rule.

use compute::Array;
use compute::elementwise::scaled_sum;
use compute::shape::{concat, slice};
use serde::Deserialize;

use crate::error::ModelError;

/// What is read of a `scheduler_config.json` in the diffusers layout.
#[derive(Clone, Debug, Deserialize)]
pub struct SchedulerConfig {
    /// beta of the first timestep.
    pub beta_start: f64,
    /// beta of the last timestep.
    pub beta_end: f64,
    /// How beta grows in between; supported is `scaled_linear`: its square root is linear.
    pub beta_schedule: String,
    /// How many timesteps there are.
    pub num_train_timesteps: u32,
    /// What the network predicts: `v_prediction` or `epsilon`.
    pub prediction_type: String,
}

/// What the network predicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PredictionType {
    /// The velocity v = a eps - s z (Salimans and Ho 2022).
    Velocity,
    /// The noise eps that was added.
    Noise,
}

/// `alpha_bar` by timestep. With a = sqrt(alpha_bar) and s = sqrt(1 - alpha_bar), the noised latent
/// is z_t = a z + s eps.
///
/// The functions over arrays take batches `[N, ...]` and one timestep for each of the N, or a
/// single one for all.
#[derive(Clone, Debug)]
pub struct Schedule {
    alpha_bar: Vec<f64>,
    prediction: PredictionType,
}

/// More timesteps than this are taken for a damaged file.
const MAX_STEPS: u32 = 100_000;

impl Schedule {
    /// The schedule that a configuration describes; an error names the field of `file` that is not
    /// supported.
    pub fn new(config: &SchedulerConfig, file: &str) -> Result<Self, ModelError> {
        if config.beta_schedule != "scaled_linear" {
            let problem = format!(
                "is {:?}; supported is \"scaled_linear\"",
                config.beta_schedule
            );
            return Err(ModelError::field(file, "beta_schedule", problem));
        }
        if !(1..=MAX_STEPS).contains(&config.num_train_timesteps) {
            let problem = format!(
                "is {}; it must be from 1 to {MAX_STEPS}",
                config.num_train_timesteps
            );
            return Err(ModelError::field(file, "num_train_timesteps", problem));
        }
        // Others divide by a and s: a beta of 1 would make a = 0, a beta of 0 would make s = 0.
        for (field, beta) in [
            ("beta_start", config.beta_start),
            ("beta_end", config.beta_end),
        ] {
            if !(beta > 0.0 && beta < 1.0) {
                return Err(ModelError::field(
                    file,
                    field,
                    format!("is {beta}; it must lie between 0 and 1"),
                ));
            }
        }
        let prediction = PredictionType::from_name(&config.prediction_type, file)?;
        Ok(Self {
            alpha_bar: alpha_bar(config),
            prediction,
        })
    }

    /// How many timesteps there are.
    pub fn len(&self) -> u32 {
        self.alpha_bar.len() as u32
    }

    /// Never: a schedule has at least one timestep.
    pub fn is_empty(&self) -> bool {
        self.alpha_bar.is_empty()
    }

    /// The share of the clean latent's variance left at timestep `t`: the product of (1 - beta) up
    /// to it.
    pub fn alpha_bar(&self, t: u32) -> f64 {
        self.alpha_bar[t as usize]
    }

    /// The factor a = sqrt(alpha_bar) of the clean latent at timestep `t`.
    pub fn a(&self, t: u32) -> f64 {
        self.alpha_bar(t).sqrt()
    }

    /// The factor s = sqrt(1 - alpha_bar) of the noise at timestep `t`.
    pub fn s(&self, t: u32) -> f64 {
        (1.0 - self.alpha_bar(t)).sqrt()
    }

    /// The noised latent a z + s eps.
    pub fn add_noise(&self, clean: &Array, noise: &Array, t: &[u32]) -> Array {
        combine(clean, noise, t, |t| [self.a(t), self.s(t)])
    }

    /// The velocity a eps - s z that a perfect network would predict for this latent and this
    /// noise.
    pub fn velocity_target(&self, clean: &Array, noise: &Array, t: &[u32]) -> Array {
        combine(noise, clean, t, |t| [self.a(t), -self.s(t)])
    }

    /// The velocity that a network's raw output means.
    pub fn velocity(&self, output: &Array, noisy: &Array, t: &[u32]) -> Array {
        match self.prediction {
            PredictionType::Velocity => output.clone(),
            // From eps = a v + s z_t.
            PredictionType::Noise => combine(output, noisy, t, |t| {
                [1.0 / self.a(t), -self.s(t) / self.a(t)]
            }),
        }
    }

    /// The gradient of a loss by a network's raw output, from the gradient by the velocity that it
    /// means.
    pub fn velocity_backward(&self, velocity_gradient: &Array, t: &[u32]) -> Array {
        match self.prediction {
            PredictionType::Velocity => velocity_gradient.clone(),
            // v = (eps - s z_t) / a, and z_t does not depend on the network.
            PredictionType::Noise => scale(velocity_gradient, t, |t| 1.0 / self.a(t)),
        }
    }

    /// The estimate of the clean latent, x0_hat = a z_t - s v.
    pub fn clean(&self, noisy: &Array, velocity: &Array, t: &[u32]) -> Array {
        combine(noisy, velocity, t, |t| [self.a(t), -self.s(t)])
    }

    /// The estimate of the noise, eps_hat = a v + s z_t.
    pub fn noise(&self, noisy: &Array, velocity: &Array, t: &[u32]) -> Array {
        combine(velocity, noisy, t, |t| [self.a(t), self.s(t)])
    }
}

impl PredictionType {
    fn from_name(name: &str, file: &str) -> Result<Self, ModelError> {
        match name {
            "v_prediction" => Ok(Self::Velocity),
            "epsilon" => Ok(Self::Noise),
            _ => {
                let problem =
                    format!("is {name:?}; supported are \"v_prediction\" and \"epsilon\"");
                Err(ModelError::field(file, "prediction_type", problem))
            }
        }
    }
}

/// The cumulative product of 1 - beta, where sqrt(beta) grows linearly.
fn alpha_bar(config: &SchedulerConfig) -> Vec<f64> {
    let start = config.beta_start.sqrt();
    let end = config.beta_end.sqrt();
    // A schedule of one timestep has no interval to divide by.
    let last = (config.num_train_timesteps - 1).max(1) as f64;
    let beta = |t: u32| (start + (end - start) * f64::from(t) / last).powi(2);
    // In f64: 1 - alpha_bar begins at 1e-4 and alpha_bar ends near 1e-3, and f32 would lose digits
    // of both.
    let mut product = 1.0;
    (0..config.num_train_timesteps)
        .map(|t| {
            product *= 1.0 - beta(t);
            product
        })
        .collect()
}

/// `f x + g y` where `[f, g]` depends on the sample's timestep.
fn combine(x: &Array, y: &Array, t: &[u32], factors: impl Fn(u32) -> [f64; 2]) -> Array {
    let sum = |x: &Array, y: &Array, t: u32| {
        let [f, g] = factors(t);
        scaled_sum(&[(f as f32, x), (g as f32, y)])
    };
    per_sample(t, x.shape()[0], |i, t| match i {
        None => sum(x, y, t),
        Some(i) => sum(&slice(x, 0, i, 1), &slice(y, 0, i, 1), t),
    })
}

/// `f x` where `f` depends on the sample's timestep.
pub(crate) fn scale(x: &Array, t: &[u32], factor: impl Fn(u32) -> f64) -> Array {
    per_sample(t, x.shape()[0], |i, t| {
        let x = i.map_or_else(|| x.clone(), |i| slice(x, 0, i, 1));
        compute::elementwise::scale(&x, factor(t) as f32)
    })
}

/// One call for the whole batch where all timesteps are equal, else one for each sample, joined
/// again.
fn per_sample(t: &[u32], batch: usize, f: impl Fn(Option<usize>, u32) -> Array) -> Array {
    assert!(
        t.len() == 1 || t.len() == batch,
        "{} timesteps for a batch of {batch}",
        t.len()
    );
    // The usual case: annealed timesteps are the same for all views.
    if t.iter().all(|&other| other == t[0]) {
        return f(None, t[0]);
    }
    let samples: Vec<Array> = t.iter().enumerate().map(|(i, &t)| f(Some(i), t)).collect();
    concat(&samples.iter().collect::<Vec<_>>(), 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use compute::Device;

    pub(crate) fn config() -> SchedulerConfig {
        SchedulerConfig {
            beta_start: 1e-4,
            beta_end: 0.02,
            beta_schedule: "scaled_linear".into(),
            num_train_timesteps: 1000,
            prediction_type: "v_prediction".into(),
        }
    }

    fn batch(values: [f32; 2]) -> Array {
        Device::cpu().array(&[2, 1], values.to_vec())
    }

    #[track_caller]
    fn assert_close(actual: &Array, expected: [f64; 2]) {
        for (actual, expected) in actual.to_vec().iter().zip(expected) {
            assert!(
                (f64::from(*actual) - expected).abs() < 1e-6,
                "{actual} is not {expected}"
            );
        }
    }

    #[test]
    fn the_table_is_that_of_the_x4_upscaler() {
        let schedule = Schedule::new(&config(), "scheduler_config.json").unwrap();
        for (t, alpha_bar, a, s) in [
            (20, 0.997301, 0.99865, 0.05195),
            (350, 0.640484, 0.80030, 0.59960),
            (500, 0.331275, 0.57556, 0.81776),
            (700, 0.066734, 0.25833, 0.96606),
            (900, 0.0045343, 0.06734, 0.99773),
            (980, 0.0010697, 0.03271, 0.99947),
        ] {
            assert!(
                (schedule.alpha_bar(t) - alpha_bar).abs() < 6e-7,
                "alpha_bar({t}) = {}",
                schedule.alpha_bar(t)
            );
            assert!(
                (schedule.a(t) - a).abs() < 6e-6 && (schedule.s(t) - s).abs() < 6e-6,
                "a, s at {t}"
            );
        }
    }

    #[test]
    fn latent_noise_and_velocity_convert_into_each_other() {
        let schedule = Schedule::new(&config(), "scheduler_config.json").unwrap();
        let clean = batch([0.7, -1.2]);
        let noise = batch([-0.4, 0.9]);
        let t = [20, 500];
        let noisy = schedule.add_noise(&clean, &noise, &t);
        let velocity = schedule.velocity_target(&clean, &noise, &t);
        assert_close(&noisy, [0.678275, 0.045303]);
        assert_close(&schedule.clean(&noisy, &velocity, &t), [0.7, -1.2]);
        assert_close(&schedule.noise(&noisy, &velocity, &t), [-0.4, 0.9]);
    }

    #[test]
    fn predicted_noise_is_read_as_velocity() {
        let schedule = Schedule::new(
            &SchedulerConfig {
                prediction_type: "epsilon".into(),
                ..config()
            },
            "config",
        )
        .unwrap();
        let clean = batch([0.7, -1.2]);
        let noise = batch([-0.4, 0.9]);
        let t = [100, 100];
        let noisy = schedule.add_noise(&clean, &noise, &t);
        let expected = schedule.velocity_target(&clean, &noise, &t).to_vec();
        assert_close(
            &schedule.velocity(&noise, &noisy, &t),
            [expected[0].into(), expected[1].into()],
        );
        assert_close(
            &schedule.velocity_backward(&batch([1.0, 2.0]), &t),
            [1.0, 2.0].map(|x| x / schedule.a(100)),
        );
    }

    #[test]
    fn what_is_not_supported_is_refused_by_name() {
        let refusals = [
            SchedulerConfig {
                beta_schedule: "linear".into(),
                ..config()
            },
            SchedulerConfig {
                prediction_type: "sample".into(),
                ..config()
            },
            SchedulerConfig {
                num_train_timesteps: 0,
                ..config()
            },
            SchedulerConfig {
                beta_end: 1.5,
                ..config()
            },
        ]
        .map(|config| {
            Schedule::new(&config, "scheduler_config.json")
                .unwrap_err()
                .to_string()
        });
        assert_eq!(
            refusals,
            [
                "scheduler_config.json: `beta_schedule` is \"linear\"; supported is \"scaled_linear\"",
                "scheduler_config.json: `prediction_type` is \"sample\"; supported are \"v_prediction\" and \"epsilon\"",
                "scheduler_config.json: `num_train_timesteps` is 0; it must be from 1 to 100000",
                "scheduler_config.json: `beta_end` is 1.5; it must lie between 0 and 1",
            ]
        );
    }
}
