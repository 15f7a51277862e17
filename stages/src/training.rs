//! What `Fit` and `Sync` share: the training loop with its log. Knows nothing of where the views
//! come from.

use artifacts_schema::Log;
use compute::Counts;
use formats::Camera;
use nerf::{Exposure, Field, StepStats, TrainOptions, Training};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::checkpoint::Checkpoint;
use crate::checkpointer::Checkpointer;
use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::photos::{self, Photos};
use crate::port::Port;
use crate::size::Sizes;
use crate::stage::{Estimate, Extension};

/// What training writes, and `Sync` begins with.
pub const FIELD: Port<artifacts_schema::Field> = Port::new("field");
/// How training went.
pub const LOG: Port<Log> = Port::new("log");

/// A log line is written every so many steps.
const LOG_EVERY: u32 = 50;

/// Refuses training parameters that make no sense.
pub fn check(options: &TrainOptions) -> Result<(), StageError> {
    convert::in_range("steps", options.steps, 1, 10_000_000)?;
    convert::in_range("samples", options.samples, 256, 1 << 24)?;
    check_rate("rate", options.rate)?;
    check_rate("final_rate", options.final_rate)
}

/// Refuses a learning rate, or a part of one, that makes no sense.
pub fn check_rate(field: &'static str, value: f64) -> Result<(), StageError> {
    if value > 0.0 && value <= 1.0 {
        return Ok(());
    }
    Err(StageError::parameter(
        field,
        format!("is {value}; it must be above 0 and at most 1"),
    ))
}

/// What training leaves beside its outputs, view by view in their order.
pub struct Trained {
    /// Where the views were taken from.
    pub cameras: Vec<Camera>,
    /// How they were exposed, where that was learnt.
    pub exposures: Option<Vec<Exposure>>,
}

/// Whether more steps may go on from fewer: only where the learning rate does not fall over all of
/// them.
pub fn extension(final_rate: f64) -> Extension {
    // Exactly, since the number is as the pipeline writes it.
    if final_rate == 1.0 {
        return Extension::Possible("steps");
    }
    Extension::Impossible(
        "steps",
        "the learning rate falls over the second half of the steps (unless `final_rate` is 1)",
    )
}

/// What training takes; `table` is the size of the field's tables in bytes, which gradient, moments
/// and a checkpoint multiply.
pub fn estimate(inputs: &Sizes, table: u64, options: &TrainOptions) -> Estimate {
    let samples = options.samples;
    // About what two cores take for a sample (docs/performance.md).
    let trained = f64::from(options.steps) * f64::from(samples) * 6e-7;
    let memory = photos::memory(inputs) + 8 * table + 1024 * u64::from(samples);
    Estimate::of(0, photos::seconds(inputs)).computing(memory, trained)
}

/// Trains `field` on photos and writes the outputs `field` and `log`. Goes on from a checkpoint
/// where there is one.
pub fn train(
    field: Field,
    photos: &[Photos],
    options: &TrainOptions,
    io: &Io,
) -> Result<Trained, StageError> {
    let mut checkpointer = Checkpointer::new(io, options.steps.into());
    let config = field.config().clone();
    // Kept apart, since the field is moved into whichever training begins.
    let bounds = field.bounds();
    let resumed = checkpointer.resume(|Checkpoint { tensors, notes, .. }| {
        let diary = Diary::deserialize(notes).map_err(|error| error.to_string())?;
        // Read here, so that they are in memory once whichever checkpoint is gone on from.
        let (views, overflow) =
            photos::views(photos, &io.scratch).map_err(|error| error.to_string())?;
        let training =
            Training::from_state(io.device, &config, bounds, views, options, io.seed, tensors);
        let training = training.map_err(|error| error.to_string())?;
        Ok((training, diary, overflow))
    })?;
    let (mut training, mut diary, overflow) = match resumed {
        Some(resumed) => resumed,
        None => {
            let (views, overflow) = photos::views(photos, &io.scratch)?;
            let training = Training::new(io.device, field, views, options, io.seed);
            (training, Diary::default(), overflow)
        }
    };
    // Counts are of this run's steps, not of those before the checkpoint.
    let begun = training.steps_taken();
    let before = io.device.counts();
    while training.steps_taken() < options.steps {
        let stats = training.step();
        // Before anything of it is kept: it may have been of black in place of photos.
        overflow.check()?;
        let step = u64::from(training.steps_taken());
        // Before the state is kept: no checkpoint is of a field that has diverged.
        if !stats.loss.is_finite() {
            return Err(StageError::Diverged { step, rate: "rate" });
        }
        diary.note(training.steps_taken(), &stats);
        checkpointer.after(step, &[("loss", stats.loss), ("psnr", diary.psnr)], || {
            checkpoint(&mut training, &diary)
        })?;
    }
    // Kept only where a run of more steps can go on from it.
    if matches!(extension(options.final_rate), Extension::Possible(_)) {
        checkpointer.keep(options.steps.into(), || checkpoint(&mut training, &diary));
    }
    io.metric("training psnr (running mean)", diary.psnr);
    // No checkpoint of more steps is gone on from, so that this does not wrap.
    tell_counts(io, before, options.steps - begun);
    // Before the field is taken out of the training, which ends it.
    let trained = Trained {
        cameras: training.cameras(),
        exposures: training.exposures(),
    };
    io.write(FIELD, &convert::disk_field(&training.into_field())?)?;
    io.write(LOG, &diary.log())?;
    Ok(trained)
}

/// What a GPU was given to do in each of so many steps.
fn tell_counts(io: &Io, before: Option<Counts>, steps: u32) {
    let Some(done) = io
        .device
        .counts()
        .zip(before)
        .map(|(after, before)| after - before)
    else {
        return;
    };
    let per_step = |count: u64| count as f64 / f64::from(steps.max(1));
    io.metric("dispatches per step", per_step(done.dispatches));
    io.metric("bytes through device memory per step", per_step(done.bytes));
    io.metric(
        "floating-point operations per step",
        per_step(done.operations),
    );
}

fn checkpoint(training: &mut Training, diary: &Diary) -> Checkpoint {
    Checkpoint {
        step: training.steps_taken().into(),
        tensors: training.state(),
        notes: json!(diary),
    }
}

/// What the log will say of the steps so far.
#[derive(Default, Serialize, Deserialize)]
struct Diary {
    /// A running mean of the batches' PSNR.
    psnr: f64,
    /// A line for every [`LOG_EVERY`] steps.
    lines: Vec<Value>,
    /// The line of the last step.
    last: Value,
}

impl Diary {
    fn note(&mut self, step: u32, stats: &StepStats) {
        self.psnr = smoothed(self.psnr, step, stats);
        self.last = json!({
            "step": step, "loss": stats.loss, "psnr": self.psnr, "rays": stats.rays, "samples": stats.samples,
        });
        if step.is_multiple_of(LOG_EVERY) {
            self.lines.push(self.last.clone());
        }
    }

    /// All lines, with that of the last step.
    fn log(mut self) -> Log {
        // The last step has a line even if it is no fiftieth.
        if self.lines.last() != Some(&self.last) {
            self.lines.push(self.last);
        }
        Log { lines: self.lines }
    }
}

/// A running mean over about the last fifty steps.
fn smoothed(mean: f64, step: u32, stats: &StepStats) -> f64 {
    // Early steps count evenly. A mean with a fixed weight would take long to come up from 0.
    mean + (stats.psnr - mean) / f64::from(step.min(LOG_EVERY))
}
