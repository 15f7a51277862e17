//! Batches that are traced in several passes.

use super::*;
use crate::batch::TrainView;
use crate::config::FieldConfig;
use crate::options::TrainOptions;
use compute::{Device, testing};
use formats::{Camera, Pixels};

/// Losses of a few steps whose batches are traced in passes, as if a ray might have so many
/// samples.
fn losses(device: &Device, most_steps: Option<usize>) -> Vec<f64> {
    let config = FieldConfig {
        levels: 2,
        log2_table: 8,
        march_steps: 16,
        ..Default::default()
    };
    let pose = glam::DMat4::from_translation(glam::DVec3::new(0.5, 0.5, 2.0));
    let camera = Camera::centered((8, 8), 8.0, pose, [1.0, 2.0]);
    let rgb = (0..192).map(|i| (i % 7) as f32 / 7.0).collect();
    let view = TrainView {
        camera,
        pixels: Pixels::opaque(rgb).into(),
        mask: None,
        weight: 1.0,
        supersample: 1,
    };
    let field = Field::new(&config, [[0.0; 3], [1.0; 3]], 1);
    let host = Trainer::new(
        field,
        vec![view],
        &TrainOptions {
            samples: 512,
            ..Default::default()
        },
        1,
    );
    let mut trainer = GpuTrainer::new(device.open_gpu().unwrap(), host);
    if let Some(most_steps) = most_steps {
        trainer.resident.most_steps = most_steps;
    }
    (0..6).map(|_| trainer.step().loss).collect()
}

#[test]
fn several_passes_learn_what_one_does() {
    let Some(device) = testing::gpu() else { return };
    let before = device.counts().unwrap();
    let whole = losses(&device, None);
    let of_one = device.counts().unwrap() - before;
    let in_parts = losses(&device, Some(1 << 16));
    let of_parts = device.counts().unwrap() - before - of_one;
    assert!(
        of_parts.dispatches > of_one.dispatches + 60,
        "{of_one:?} {of_parts:?}"
    );
    for (step, (whole, part)) in whole.iter().zip(&in_parts).enumerate() {
        assert!(
            (whole / part - 1.0).abs() < 1e-4,
            "step {step}: {part} beside {whole}"
        );
    }
}
