//! Fits colours, opacities and sizes of splats to pictures, one picture a step, in a fixed order.
//! Places and directions stay: they are the field's. Knows no files.

use formats::Camera;
use glam::Vec3;
use rayon::prelude::*;

use crate::adam::{Moments, Step};
use crate::cloud::{Cloud, Splat};
use crate::harmonics::MOST;
use crate::picture::Picture;
use crate::project::BySplat;
use crate::raster::error_backward;

/// By what numbers change in a step at the beginning; at the end by a tenth of that.
const COLOR: f32 = 0.02;
const TURNING_COLOR: f32 = 0.004;
const LOGIT: f32 = 0.05;
const LOG_SCALE: f32 = 0.02;
const END: f32 = 0.1;
/// How far sizes may go from where they began, as a factor: a disc that shows in no picture of its
/// own must not cover another's.
const FARTHEST: f32 = 4.0;

/// A cloud that is being fitted.
pub struct Fit {
    cloud: Cloud,
    began: Vec<Vec3>,
    moments: Vec<Own>,
    steps: u32,
    done: u32,
}

/// The moments of a splat's numbers.
#[derive(Clone, Default)]
struct Own {
    harmonics: [[Moments; 3]; MOST],
    logit: Moments,
    log_scale: [Moments; 3],
}

impl Fit {
    /// Begins with a cloud that has its first colours, for so many steps.
    pub fn new(cloud: Cloud, steps: u32) -> Self {
        Self {
            began: cloud.splats.iter().map(|splat| splat.log_scale).collect(),
            moments: vec![Own::default(); cloud.splats.len()],
            cloud,
            steps,
            done: 0,
        }
    }

    /// Whether there is more to do.
    pub fn goes_on(&self) -> bool {
        self.done < self.steps
    }

    /// Which of `count` pictures is next: each once a round, the next rounds in other orders.
    pub fn next_picture(&self, count: usize) -> usize {
        let round = self.done as usize / count.max(1);
        let place = self.done as usize % count.max(1);
        // Steps without a common divisor with the count go through all.
        let mut stride = 1 + (round * 7 + 2) % count.max(1);
        while divisor(stride, count) != 1 {
            stride += 1;
        }
        (place * stride + round) % count.max(1)
    }

    /// A step towards a picture. Gives how near the cloud was before, in dB.
    pub fn step(&mut self, camera: &Camera, truth: &Picture) -> f64 {
        let (error, by) = error_backward(&self.cloud, camera, truth);
        self.done += 1;
        let part = self.done as f32 / self.steps.max(1) as f32;
        // Half a wave of the cosine, from 1 to END.
        let slow = END + (1.0 - END) * 0.5 * (1.0 + (std::f32::consts::PI * part).cos());
        let step = Step::new(self.done);
        let splats = self.cloud.splats.par_iter_mut().zip(&mut self.moments);
        splats
            .zip(by.par_iter().zip(&self.began))
            .for_each(|((splat, own), (by, began))| own.change(splat, by, slow, step, *began));
        // The error is halved, and summed over four channels.
        let mean = 2.0 * error / (4.0 * truth.pixels.len().max(1) as f64);
        -10.0 * mean.log10()
    }

    /// The cloud as it is.
    pub fn cloud(self) -> Cloud {
        self.cloud
    }
}

impl Own {
    fn change(&mut self, splat: &mut Splat, by: &BySplat, slow: f32, step: Step, began: Vec3) {
        for (i, own) in self.harmonics.iter_mut().enumerate() {
            // Directions learn slower, as in Kerbl et al., where the factor is 20.
            let rate = slow * if i == 0 { COLOR } else { TURNING_COLOR };
            for (channel, own) in own.iter_mut().enumerate() {
                let gradient = by.harmonics[i][channel];
                splat.harmonics[i][channel] += own.change(gradient, rate, step);
            }
        }
        splat.logit += self.logit.change(by.logit, slow * LOGIT, step);
        let reach = Vec3::splat(FARTHEST.ln());
        for (axis, own) in self.log_scale.iter_mut().enumerate() {
            splat.log_scale[axis] += own.change(by.log_scale[axis], slow * LOG_SCALE, step);
        }
        // After the step, and not as a bound on it: the moments stay those of the gradients.
        splat.log_scale = splat.log_scale.clamp(began - reach, began + reach);
    }
}

fn divisor(a: usize, b: usize) -> usize {
    match b {
        0 => a,
        _ => divisor(b, a % b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_round_goes_through_all_pictures() {
        for count in [1, 2, 7, 12] {
            let mut fit = Fit::new(Cloud::default(), 99);
            for round in 0..3 {
                let mut seen: Vec<usize> = (0..count)
                    .map(|place| {
                        fit.done = (round * count + place) as u32;
                        fit.next_picture(count)
                    })
                    .collect();
                seen.sort_unstable();
                assert_eq!(seen, (0..count).collect::<Vec<_>>());
            }
        }
    }
}
