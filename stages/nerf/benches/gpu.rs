//! Training steps of a field on a GPU: what each gives the device to do, kernel by kernel, and how
//! long it takes beside the roofline, the time that the arithmetic or the memory would take alone.
//!
//! `make bench-gpu [GPU=1] [PEAK=82600,1008]`, as for the operators of the networks. With
//! GPU=counts a few steps run on whatever adapter there is, be it one of software, and nothing is
//! timed.

use std::f64::consts::TAU;
use std::time::Instant;

use compute::Device;
use formats::{Camera, Pixels};
use glam::DVec3;
use nerf::{Field, FieldConfig, GpuTrainer, TrainOptions, TrainView, Trainer, Work};

/// Steps before the figures are taken.
const WARM_UP: u32 = 4;
/// Steps that are timed together at most, past the warm-up of the occupancy grid; and seconds.
const TIMED: (u32, f64) = (320, 10.0);

/// A photo of coloured stripes, the same from all around.
fn view(angle: f64) -> TrainView {
    let position = DVec3::new(3.0 * angle.sin(), 0.8, 3.0 * angle.cos());
    let camera = Camera::centered(
        (128, 128),
        160.0,
        Camera::look_at(position, DVec3::ZERO),
        [1.0, 6.0],
    );
    let rgb = (0..128 * 128)
        .flat_map(|i| [0.3 + 0.4 * f32::from(i as u8 % 32 / 16), 0.5, 0.2])
        .collect();
    TrainView {
        camera,
        pixels: Pixels::opaque(rgb).into(),
        mask: None,
        weight: 1.0,
        supersample: 2,
    }
}

fn trainer(device: &Device) -> Option<GpuTrainer> {
    let field = Field::new(&FieldConfig::default(), [[-1.0; 3], [1.0; 3]], 1);
    let views = (0..8).map(|i| view(f64::from(i) * TAU / 8.0)).collect();
    Some(GpuTrainer::new(
        device.open_gpu()?,
        Trainer::new(field, views, &TrainOptions::default(), 1),
    ))
}

/// Milliseconds per training step.
fn time(device: &Device, trainer: &mut GpuTrainer) -> f64 {
    device.finish();
    let begin = Instant::now();
    let mut steps = 0;
    while steps < TIMED.0 && begin.elapsed().as_secs_f64() < TIMED.1 {
        trainer.step();
        steps += 1;
    }
    device.finish();
    begin.elapsed().as_secs_f64() * 1e3 / f64::from(steps)
}

fn main() {
    let gpu = std::env::var("GPU").unwrap_or_default();
    let runs = gpu != "counts";
    let device =
        Device::gpu(if runs { gpu.parse().ok() } else { Some(0) }).unwrap_or_else(|error| {
            eprintln!("nothing to measure: {error}");
            std::process::exit(if gpu.is_empty() { 0 } else { 2 })
        });
    let peak = std::env::var("PEAK").unwrap_or_else(|_| "82600,1008".into());
    let mut peak = peak.split(',').filter_map(|figure| figure.parse().ok());
    let flops = peak.next().unwrap_or(82_600.0);
    let bytes = peak.next().unwrap_or(1008.0);
    // Operations over GFLOP/s, and bytes over GB/s, are nanoseconds.
    let roof = |work: &Work| 1e-3 * (work.operations as f64 / flops).max(work.bytes as f64 / bytes);
    let Some(mut trainer) = trainer(&device) else {
        return;
    };
    let last = (0..WARM_UP).map(|_| trainer.step()).last();
    println!(
        "{}\n\nA step of {} rays and {} samples.\n",
        device.kind(),
        last.map_or(0, |step| step.rays),
        last.map_or(0, |step| step.samples)
    );
    println!("| kernel | GFLOP | MB | roofline us |\n|---|---|---|---|");
    let row = |name: &str, work: &Work, roof: f64| {
        println!(
            "| {name} | {:.3} | {:.2} | {roof:.1} |",
            work.operations as f64 * 1e-9,
            work.bytes as f64 * 1e-6
        );
    };
    trainer
        .work()
        .iter()
        .for_each(|(name, work)| row(name, work, roof(work)));
    let all = trainer
        .work()
        .iter()
        .fold(Work::default(), |sum, (_, work)| Work {
            operations: sum.operations + work.operations,
            bytes: sum.bytes + work.bytes,
        });
    let least = trainer.work().iter().map(|(_, work)| roof(work)).sum();
    row("all", &all, least);
    if runs {
        let measured = time(&device, &mut trainer);
        println!(
            "\n{measured:.3} ms per step, of which the roofline is {:.2}",
            1e-3 * least / measured
        );
    }
}
