//! Speed and quality of training and rendering, beside a plain PyTorch NeRF on the same rays:
//! `cargo bench -p nerf --bench reference`, with the environment's `PYTHON` an interpreter that has torch and numpy;
//! without it only ours is measured. Two threads each, one after the other. `-- still_life` or the folder of an LLFF
//! scene, then `name=value` settings. With `CURVE` a file's name, PSNR over time is drawn there.

mod curve;
mod exchange;

use metrics::Image;
use nerf::{Field, FieldConfig, RenderOptions, TrainOptions, TrainView, Trainer, render};
use scene::{Photo, Reduction, downscale, llff, split_holdout, still_life};
use serde::Deserialize;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

/// What was measured after so many steps.
#[derive(Clone, Copy, Deserialize)]
pub struct Mark {
    /// Training steps so far.
    pub step: u32,
    /// Seconds of training so far, without evaluations.
    pub seconds: f64,
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

/// The photos of a run, and how the field is trained on them.
pub struct Task {
    /// Photos to train on.
    pub train: Vec<Photo>,
    /// Held-out photos.
    pub test: Vec<Photo>,
    /// The scene box.
    pub bounds: [[f32; 3]; 2],
    /// The shape of the field.
    pub config: FieldConfig,
    /// How to train.
    pub options: TrainOptions,
    /// Steps after which the held-out views are looked at.
    pub marks: Vec<u32>,
}

fn main() -> Result<(), Box<dyn Error>> {
    rayon::ThreadPoolBuilder::new().num_threads(2).build_global()?;
    let task = task(std::env::args().skip(1).filter(|argument| argument != "--bench"))?;
    let (ours, images) = train(&task);
    report("ours", &ours, ssim(&task, &images));
    let Some(python) = std::env::var_os("PYTHON").filter(|python| !python.is_empty()) else { return Ok(()) };
    let (reference, images) = exchange::reference(&python, &task)?;
    report("reference", &reference, ssim(&task, &images));
    compare(&ours, &reference);
    if let Some(file) = std::env::var_os("CURVE").filter(|file| !file.is_empty()) {
        std::fs::write(file, curve::svg(&[("this project", &ours), ("PyTorch reference", &reference)]))?;
    }
    Ok(())
}

fn task(mut arguments: impl Iterator<Item = String>) -> Result<Task, Box<dyn Error>> {
    let source = arguments.next().unwrap_or("still_life".into());
    let (mut config, mut options) = (FieldConfig::default(), TrainOptions { steps: 400, ..TrainOptions::default() });
    for argument in arguments {
        let (name, value) = argument.split_once('=').ok_or("settings look like name=value")?;
        match name {
            "steps" => options.steps = value.parse()?,
            "samples" => options.samples = value.parse()?,
            "table" => config.log2_table = value.parse()?,
            _ => return Err(format!("no setting is called {name}").into()),
        }
    }
    let (scene, factor) = match source.as_str() {
        "still_life" => (still_life(24, (256, 192), 2, 0), 2),
        folder => (llff(Path::new(folder), Some("images_4"), Some((252, 189)))?, 1),
    };
    let small = |photo: &Photo| downscale(photo, factor, Reduction::Area);
    let (train, test) = split_holdout(scene.photos.iter().map(small).collect::<Result<Vec<_>, _>>()?, 8);
    let marks = (1..=8).map(|i| options.steps * i * i / 64).collect();
    Ok(Task { train, test, bounds: scene.bounds.map(|corner| corner.map(|x| x as f32)), config, options, marks })
}

/// Trains, stopping the clock at every mark to look at the held-out views; returns the last of those looks too.
fn train(task: &Task) -> Outcome {
    let view = |photo: &Photo| TrainView {
        camera: photo.camera.clone(),
        rgb: photo.rgb.clone(),
        alpha: photo.alpha.clone(),
        weight: 1.0,
        supersample: 1,
    };
    let field = Field::new(&task.config, task.bounds, 0);
    let mut trainer = Trainer::new(field, task.train.iter().map(view).collect(), &task.options, 0);
    let (mut marks, mut images, mut seconds, mut samples) = (vec![], vec![], 0.0, 0);
    for step in 1..=task.options.steps {
        let start = Instant::now();
        samples += trainer.step().samples;
        seconds += start.elapsed().as_secs_f64();
        if task.marks.contains(&step) {
            let start = Instant::now();
            let looks: Vec<_> = task
                .test
                .iter()
                .map(|photo| render(trainer.field(), &photo.camera, &RenderOptions::default()))
                .collect();
            let rendering = start.elapsed().as_secs_f64();
            let rays: usize = looks.iter().map(|look| look.depth.len()).sum();
            let rendered: usize = looks.iter().map(|look| look.samples).sum();
            images = looks.into_iter().map(|look| look.rgb).collect();
            let (rays_a_second, samples_a_second) = (rays as f64 / rendering, rendered as f64 / rendering);
            marks.push(Mark { step, seconds, samples, psnr: psnr(task, &images), rays_a_second, samples_a_second });
        }
    }
    (marks, images)
}

fn image<'a>(photo: &Photo, rgb: &'a [f32]) -> Image<'a> {
    Image::new(photo.camera.width as usize, photo.camera.height as usize, rgb)
}

fn psnr(task: &Task, images: &[Vec<f32>]) -> f64 {
    let one = |(photo, rgb): (&Photo, &Vec<f32>)| metrics::psnr(image(photo, &photo.rgb), image(photo, rgb));
    task.test.iter().zip(images).map(one).sum::<f64>() / task.test.len() as f64
}

fn ssim(task: &Task, images: &[Vec<f32>]) -> f64 {
    let one = |(photo, rgb): (&Photo, &Vec<f32>)| metrics::ssim(image(photo, &photo.rgb), image(photo, rgb));
    task.test.iter().zip(images).filter_map(one).sum::<f64>() / task.test.len() as f64
}

fn report(name: &str, marks: &[Mark], ssim: f64) {
    println!("{name}");
    for mark in marks {
        let million = |x: f64| x / 1e6;
        println!(
            "  step {:5} {:7.2} s  {:.2} dB  trained {:.3}, rendered {:.3} million samples/s, {:.3} million rays/s",
            mark.step,
            mark.seconds,
            mark.psnr,
            million(mark.samples as f64 / mark.seconds),
            million(mark.samples_a_second),
            million(mark.rays_a_second),
        );
    }
    println!("  SSIM {ssim:.4}");
}

/// Ratios over the last three quarters of the steps, when the occupancy grids have settled.
fn compare(ours: &[Mark], reference: &[Mark]) {
    let speed = |marks: &[Mark]| {
        let (from, to) = (marks[marks.len() / 2 - 1], marks[marks.len() - 1]);
        let trained = (to.samples - from.samples) as f64 / (to.seconds - from.seconds);
        [trained, (to.step - from.step) as f64 / (to.seconds - from.seconds), to.samples_a_second, to.rays_a_second]
    };
    let (ours, reference) = (speed(ours), speed(reference));
    for (i, name) in ["samples trained", "steps", "samples rendered", "rays rendered"].into_iter().enumerate() {
        println!("{name} a second: {:.4e} against {:.4e}: {:.1} times", ours[i], reference[i], ours[i] / reference[i]);
    }
}
