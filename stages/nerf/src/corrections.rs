//! What is learnt about the views beside the field: how they were exposed, and from where. Knows
//! nothing of how rays are traced.

use crate::batch::{Pixel, TrainView};
use crate::exposure::{Exposure, Exposures};
use crate::field::Field;
use crate::kernels::slope::positions_backward;
use crate::options::TrainOptions;
use crate::poses::{Gauge, Poses};
use crate::samples::Samples;
use crate::tensors::{FieldError, Tensors};
use crate::view_parameters::{COUNT, ViewVector};
use crate::volume_rendering::FieldGradient;
use glam::Vec3;

/// What is learnt about the views.
#[derive(Clone, Debug)]
pub struct Corrections {
    /// How they were exposed, where that is asked for.
    pub exposures: Option<Exposures>,
    /// From where they were taken, where that is asked for.
    pub poses: Option<Poses>,
}

/// Gradients to the views' parameters that a part of a batch adds, by view. Empty where nothing is
/// learnt.
#[derive(Default)]
pub struct ViewGradients {
    /// To the six parameters of the exposures.
    pub exposures: Vec<ViewVector>,
    /// Torques and forces on the cameras.
    pub poses: Vec<ViewVector>,
}

impl ViewGradients {
    /// Forgets everything, and makes room for what is learnt.
    pub fn clear(&mut self, views: usize, of_exposures: bool, of_poses: bool) {
        for (gradients, wanted) in [
            (&mut self.exposures, of_exposures),
            (&mut self.poses, of_poses),
        ] {
            gradients.clear();
            gradients.resize(if wanted { views } else { 0 }, [0.0; COUNT]);
        }
    }
}

impl Corrections {
    /// None yet: views are as they are given.
    pub fn new(options: &TrainOptions, views: &[TrainView]) -> Self {
        let cameras = || views.iter().map(|view| view.camera).collect();
        let exposure = options.exposure.as_ref();
        Self {
            exposures: exposure.map(|options| Exposures::new(options, views.len())),
            poses: options
                .poses
                .as_ref()
                .map(|options| Poses::new(options, cameras())),
        }
    }

    /// From now on the field, which stays as it is, holds the cameras in place.
    pub fn trust_field(&mut self) {
        if let Some(poses) = &mut self.poses {
            poses.gauge = Gauge::Field;
        }
    }

    /// How a view was exposed, where that is learnt.
    pub fn exposure(&self, view: usize) -> Option<Exposure> {
        self.exposures.as_ref().map(|exposures| exposures.of(view))
    }

    /// Whether the step after so many moves cameras.
    pub fn move_cameras(&self, steps: u32) -> bool {
        self.poses
            .as_ref()
            .is_some_and(|poses| poses.move_after(steps))
    }

    /// The step after so many, from the gradients of a batch's parts in their order; cameras of
    /// `views` follow.
    pub fn descend<'a>(
        &mut self,
        parts: impl Iterator<Item = &'a ViewGradients> + Clone,
        options: &TrainOptions,
        steps: u32,
        views: &mut [TrainView],
    ) {
        if let Some(exposures) = &mut self.exposures {
            // The exposures' rate rises and falls as the field's does.
            let share = options.rate_after(steps) / options.rate;
            exposures.descend(parts.clone().map(|part| &part.exposures), share, steps + 1);
        }
        // Nothing before `start`, not even in the moments: what a raw field says of cameras is not
        // remembered.
        if let Some(poses) = self.poses.as_mut().filter(|poses| poses.move_after(steps)) {
            poses.descend(parts.map(|part| &part.poses), steps, options.steps);
            self.place(views);
        }
    }

    /// Puts the cameras where they are now.
    fn place(&self, views: &mut [TrainView]) {
        if let Some(poses) = &self.poses {
            let views = views.iter_mut().enumerate();
            views.for_each(|(i, view)| view.camera = poses.camera(i));
        }
    }

    /// All parameters and their moments, by names that begin with `trainer.`.
    pub fn tensors(&self) -> Tensors {
        let exposures = self.exposures.iter().flat_map(Exposures::tensors);
        exposures
            .chain(self.poses.iter().flat_map(Poses::tensors))
            .collect()
    }

    /// Takes up what [`Corrections::tensors`] gave; cameras of `views` follow.
    pub fn read(&mut self, tensors: &Tensors, views: &mut [TrainView]) -> Result<(), FieldError> {
        if let Some(exposures) = &mut self.exposures {
            exposures.read(tensors)?;
        }
        if let Some(poses) = &mut self.poses {
            poses.read(tensors)?;
            self.place(views);
        }
        Ok(())
    }
}

/// Adds the torques and forces on the cameras of some pixels' rays, from the gradients at their
/// samples and to their directions. Samples keep their places before the camera: a turn and a shift
/// take them along.
pub fn cameras_backward(
    field: &Field,
    views: &[TrainView],
    pixels: &[Pixel],
    samples: &Samples,
    gradient: &FieldGradient,
    gradients: &mut [ViewVector],
) {
    let d_samples = samples_backward(field, samples, gradient);
    let directions = gradient.directions.iter().flatten();
    let mut rays = samples.rays.iter().zip(&samples.segments).zip(directions);
    for pixel in pixels {
        let view = &views[pixel.view];
        let position = view.camera.position();
        let mut torque = Vec3::ZERO;
        let mut force = Vec3::ZERO;
        for ((ray, segment), d_direction) in rays.by_ref().take(view.rays_per_pixel()) {
            // Colours depend on the direction, which turns with the camera and does not shift.
            torque += Vec3::from(segment.view).cross(Vec3::from(*d_direction));
            for sample in ray.clone() {
                let unit = samples.positions.at(sample);
                let world = field.space.to_world(unit.map(f64::from));
                let point = world.map(|x| x as f32);
                let d = Vec3::from(field.space.to_unit_backward(point, d_samples[sample]));
                // About the camera's place: a turn moves what is far more than what is near.
                torque += (glam::DVec3::from(world) - position).as_vec3().cross(d);
                force += d;
            }
        }
        let sums = torque.to_array().into_iter().chain(force.to_array());
        gradients[pixel.view]
            .iter_mut()
            .zip(sums)
            .for_each(|(sum, d)| *sum += d);
    }
}

/// The gradients to the samples' places in unit space, level by level.
fn samples_backward(field: &Field, samples: &Samples, gradient: &FieldGradient) -> Vec<[f32; 3]> {
    let mut d_samples = vec![[0.0; 3]; samples.t.len()];
    for (level, d_features) in field.levels.iter().zip(&gradient.levels) {
        let table = &field.table[level.offset..level.offset + level.entries];
        // With padding, whose gradients are zero.
        let places = gradient.positions.since(0);
        positions_backward(level, table, places, d_features, &mut d_samples);
    }
    d_samples
}

#[cfg(test)]
mod tests;
