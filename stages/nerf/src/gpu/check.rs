//! A small field, rendered and trained for a moment: numbers by which one device can be compared
//! with another.

use super::render::Renderer;
use crate::batch::TrainView;
use crate::config::FieldConfig;
use crate::field::Field;
use crate::options::TrainOptions;
use crate::render::RenderOptions;
use crate::training::Training;
use compute::Device;
use formats::{Camera, Pixels};
use glam::{DMat4, DVec3};

/// What a device makes of it.
pub struct Check {
    /// Colours and opacities of an image.
    pub image: Vec<f32>,
    /// Losses of the first training steps.
    pub losses: Vec<f32>,
}

/// Computes all of it on a device.
pub fn check(device: &Device) -> Check {
    let config = FieldConfig {
        levels: 6,
        log2_table: 12,
        occupancy_resolution: 16,
        ..Default::default()
    };
    let field = Field::new(&config, [[0.0; 3], [1.0, 0.8, 0.9]], 1);
    let camera = Camera::centered(
        (12, 9),
        12.0,
        DMat4::from_translation(DVec3::new(0.5, 0.4, 1.8)),
        [0.9, 1.8],
    );
    let image = Renderer::new(device, &field).render(&camera, &RenderOptions::default());
    let rgb = (0..3 * 12 * 9).map(|i| (i % 11) as f32 / 11.0).collect();
    let view = TrainView {
        camera,
        pixels: Pixels::opaque(rgb).into(),
        mask: None,
        weight: 1.0,
        supersample: 2,
    };
    let options = TrainOptions {
        samples: 512,
        ..TrainOptions::default()
    };
    let mut training = Training::new(device, field, vec![view], &options, 1);
    Check {
        image: [image.rgb, image.opacity].concat(),
        losses: (0..3).map(|_| training.step().loss as f32).collect(),
    }
}
