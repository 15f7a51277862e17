//! Speed and quality of training and rendering, beside a plain PyTorch NeRF on the same rays:
//! `cargo bench -p nerf --bench reference`, with the environment's `PYTHON` an interpreter that has
//! torch and numpy; without it only ours is measured. Two threads each, one after the other. `--
//! still_life` or the folder of an LLFF scene, then `name=value` settings. With `CURVE` a file's
//! name, PSNR over time is drawn there.

mod curve;
mod exchange;
mod task;

use metrics::Image;
use nerf::{Field, RenderOptions, Trainer, render};
use rustix::time::{ClockId, clock_gettime};
use scene::Photo;
use serde::Deserialize;
use std::error::Error;
use std::time::Instant;
use task::Task;

/// Threads of either program.
const THREADS: usize = 2;

/// What was measured after so many steps.
#[derive(Clone, Copy, Deserialize)]
pub struct Mark {
    /// Training steps so far.
    pub step: u32,
    /// Seconds of training so far, without evaluations.
    pub seconds: f64,
    /// Processor seconds of training so far, of all threads.
    pub processor_seconds: f64,
    /// Samples trained on so far.
    pub samples: usize,
    /// Mean PSNR of the held-out views.
    pub psnr: f64,
    /// Rays rendered a second.
    pub rays_a_second: f64,
    /// Samples rendered a second, counting those that a ray's end does not hide.
    pub samples_a_second: f64,
}

/// What was measured along the way, and the last images of the held-out views.
pub type Outcome = (Vec<Mark>, Vec<Vec<f32>>);

fn main() -> Result<(), Box<dyn Error>> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(THREADS)
        .build_global()?;
    let task = Task::new(
        std::env::args()
            .skip(1)
            .filter(|argument| argument != "--bench"),
    )?;
    // On a thread of the pool, as stages run.
    let (ours, images) = rayon::scope(|_| train(&task));
    report("ours", &ours, ssim(&task, &images));
    let Some(python) = std::env::var_os("PYTHON").filter(|python| !python.is_empty()) else {
        return Ok(());
    };
    let (reference, images) = exchange::reference(&python, &task)?;
    report("reference", &reference, ssim(&task, &images));
    compare(&ours, &reference);
    if let Some(file) = std::env::var_os("CURVE").filter(|file| !file.is_empty()) {
        std::fs::write(
            file,
            curve::svg(&[("this project", &ours), ("PyTorch reference", &reference)]),
        )?;
    }
    Ok(())
}

/// Trains, stopping the clock at every mark to look at the held-out views; returns the last of
/// those looks too.
fn train(task: &Task) -> Outcome {
    let field = Field::in_space(&task.config, task.space.clone(), 0);
    let mut trainer = Trainer::new(field, task.views(), &task.options, 0);
    let options = RenderOptions {
        background: task.background,
        ..RenderOptions::default()
    };
    let mut marks = vec![];
    let mut images = vec![];
    let mut samples = 0;
    let mut seconds = 0.0;
    let mut processor_seconds = 0.0;
    for step in 1..=task.options.steps {
        let start = Instant::now();
        let work = processor();
        samples += trainer.step().samples;
        seconds += start.elapsed().as_secs_f64();
        processor_seconds += processor() - work;
        if task.marks.contains(&step) {
            let start = Instant::now();
            let looks: Vec<_> = task
                .test
                .iter()
                .map(|photo| render(trainer.field(), &photo.camera, &options))
                .collect();
            let rendering = start.elapsed().as_secs_f64();
            let rays: usize = looks.iter().map(|look| look.depth.len()).sum();
            let rendered: usize = looks.iter().map(|look| look.samples).sum();
            images = looks.into_iter().map(|look| look.rgb).collect();
            let rays_a_second = rays as f64 / rendering;
            let samples_a_second = rendered as f64 / rendering;
            // Outside the clocks of training and of rendering.
            let psnr = psnr(task, &images);
            marks.push(Mark {
                step,
                seconds,
                processor_seconds,
                samples,
                psnr,
                rays_a_second,
                samples_a_second,
            });
        }
    }
    (marks, images)
}

/// Processor seconds that this process has taken.
fn processor() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn image<'a>(photo: &Photo, rgb: &'a [f32]) -> Image<'a> {
    Image::new(
        photo.camera.width as usize,
        photo.camera.height as usize,
        rgb,
    )
}

fn psnr(task: &Task, images: &[Vec<f32>]) -> f64 {
    let one = |(photo, rgb): (&Photo, &Vec<f32>)| {
        metrics::psnr(image(photo, &photo.pixels.rgb), image(photo, rgb))
    };
    task.test.iter().zip(images).map(one).sum::<f64>() / task.test.len() as f64
}

fn ssim(task: &Task, images: &[Vec<f32>]) -> f64 {
    let one = |(photo, rgb): (&Photo, &Vec<f32>)| {
        metrics::ssim(image(photo, &photo.pixels.rgb), image(photo, rgb))
    };
    task.test.iter().zip(images).filter_map(one).sum::<f64>() / task.test.len() as f64
}

fn report(name: &str, marks: &[Mark], ssim: f64) {
    println!("{name}");
    for mark in marks {
        let million = |x: f64| x / 1e6;
        println!(
            "  step {:5} {:7.1} s, {:7.1} s of processors  {:.2} dB  {:.1} million samples, {:.3} million/s a processor; \
             rendered {:.3} million samples/s, {:.3} million rays/s",
            mark.step,
            mark.seconds,
            mark.processor_seconds,
            mark.psnr,
            million(mark.samples as f64),
            million(mark.samples as f64 / mark.processor_seconds),
            million(mark.samples_a_second),
            million(mark.rays_a_second),
        );
    }
    println!("  SSIM {ssim:.4}");
}

/// Ratios over the last three quarters of the steps, when the occupancy grids have settled; over
/// all after one look.
fn compare(ours: &[Mark], reference: &[Mark]) {
    let speed = |marks: &[Mark]| {
        let settled = (marks.len() / 2).checked_sub(1).map(|i| marks[i]);
        let (samples, step, seconds) =
            settled.map_or((0, 0, 0.0), |from| (from.samples, from.step, from.seconds));
        let to = marks[marks.len() - 1];
        let a_second = |count: f64| count / (to.seconds - seconds);
        let [samples, steps] = [(to.samples - samples) as f64, f64::from(to.step - step)];
        [
            a_second(samples),
            a_second(steps),
            to.samples_a_second,
            to.rays_a_second,
        ]
    };
    let ours = speed(ours);
    let reference = speed(reference);
    for (i, name) in [
        "samples trained",
        "steps",
        "samples rendered",
        "rays rendered",
    ]
    .into_iter()
    .enumerate()
    {
        println!(
            "{name} a second: {:.4e} against {:.4e}: {:.1} times",
            ours[i],
            reference[i],
            ours[i] / reference[i]
        );
    }
}
