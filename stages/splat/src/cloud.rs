//! Splats, in memory. Knows no cameras.

use glam::{Mat3, Quat, Vec3};

use crate::harmonics::{self, MOST};

/// One Gaussian with a colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Its middle, in world space.
    pub position: Vec3,
    /// Turns its axes into the world's; the third is the normal of a disc.
    pub rotation: Quat,
    /// Logarithms of the standard deviations along its axes.
    pub log_scale: Vec3,
    /// The logit of its opacity in the middle.
    pub logit: f32,
    /// Coefficients of its colour, sRGB-encoded, of which the cloud's degree uses the first.
    pub harmonics: [[f32; 3]; MOST],
}

/// Splats of one scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// The splats, in the order in which files list them.
    pub splats: Vec<Splat>,
    /// The degree of their harmonics.
    pub degree: u32,
}

impl Splat {
    /// Its opacity in the middle.
    pub fn opacity(&self) -> f32 {
        // Fitted as a logit it stays between 0 and 1 whatever a step does.
        1.0 / (1.0 + (-self.logit).exp())
    }

    /// Standard deviations along its axes.
    pub fn scale(&self) -> Vec3 {
        // Fitted as logarithms they stay above 0.
        self.log_scale.exp()
    }

    /// Its axes in the world, of unit length.
    pub fn axes(&self) -> [Vec3; 3] {
        let axes = Mat3::from_quat(self.rotation);
        [axes.x_axis, axes.y_axis, axes.z_axis]
    }

    /// Its colour without a direction, from 0 to 1.
    pub fn flat_color(&self) -> [f32; 3] {
        self.harmonics[0].map(|part| (0.5 + harmonics::FLAT * part).clamp(0.0, 1.0))
    }
}

impl Cloud {
    /// Coefficients that count, of each splat.
    pub fn coefficients(&self) -> usize {
        harmonics::count(self.degree)
    }
}
