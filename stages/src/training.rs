//! What `Fit` and `Sync` share: the training loop with its log. Knows nothing of where the views come from.

use artifacts_schema::Log;
use nerf::{Field, StepStats, TrainOptions, TrainView, Trainer};
use serde_json::json;

use crate::convert;
use crate::error::StageError;
use crate::stage::Io;

/// A log line is written every so many steps.
const LOG_EVERY: u32 = 50;

/// Refuses training parameters that make no sense.
pub fn check(steps: u32, samples: u32, rate: f64) -> Result<(), StageError> {
    convert::in_range("steps", steps, 1, 10_000_000)?;
    convert::in_range("samples", samples, 256, 1 << 24)?;
    if rate > 0.0 && rate <= 1.0 {
        return Ok(());
    }
    Err(StageError::parameter("rate", format!("is {rate}; it must be above 0 and at most 1")))
}

/// Trains `field` on `views` and writes the outputs `field` and `log`.
pub fn train(field: Field, views: Vec<TrainView>, options: &TrainOptions, io: &Io) -> Result<(), StageError> {
    let mut trainer = Trainer::new(field, views, options, io.seed);
    let (mut lines, mut psnr) = (Vec::new(), 0.0);
    for step in 1..=options.steps {
        let stats = trainer.step();
        psnr = smoothed(psnr, step, &stats);
        io.progress(step as usize, options.steps as usize, &[("loss", stats.loss), ("psnr", psnr)])?;
        if step % LOG_EVERY == 0 || step == options.steps {
            lines.push(
                json!({ "step": step, "loss": stats.loss, "psnr": psnr, "rays": stats.rays, "samples": stats.samples }),
            );
        }
    }
    io.metric("training psnr (running mean)", psnr);
    io.write("field", &convert::disk_field(&trainer.into_field())?)?;
    io.write("log", &Log { lines })
}

/// A running mean over about the last fifty steps.
fn smoothed(mean: f64, step: u32, stats: &StepStats) -> f64 {
    mean + (stats.psnr - mean) / f64::from(step.min(LOG_EVERY))
}
