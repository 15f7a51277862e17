//! Prints the time of whole networks of tiny-x4: `networks.py` beside this file puts them, and the
//! upscaler's, beside PyTorch.

use std::time::Instant;

use compute::elementwise::scale;
use compute::{Device, Rng};
use diffusion::unet::Input;
use diffusion::{ModelError, ModelSource, Prior};

const RUNS: usize = 5;
const BATCH: usize = 4;

/// The median of some runs, in milliseconds.
fn median(mut run: impl FnMut()) -> f64 {
    let time = |_| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64() * 1e3
    };
    let mut times: Vec<f64> = (0..RUNS).map(time).collect();
    times.sort_by(f64::total_cmp);
    // A median leaves out the runs that another process has disturbed.
    times[RUNS / 2]
}

fn main() -> Result<(), ModelError> {
    let device = Device::cpu();
    let prior = Prior::load(&ModelSource::Embedded, &device)?;
    let unet = &prior.unet;
    let rng = Rng::new(0, "timing");
    let lora = unet.new_lora(4, 4.0, 0);
    let text = unet.text(&prior.text(&["high resolution, 4K, photo"]));
    // 16 channels of a latent and 3 colours of the low-resolution image.
    let sample = rng.normals(0, &[BATCH, 19, 32, 32], &device);
    let frozen = Input {
        sample: &sample,
        timesteps: &[500; BATCH],
        class_labels: &[20; BATCH],
        lora: None,
        camera: None,
    };
    let adapted = Input {
        lora: Some(&lora),
        ..frozen
    };
    println!(
        "tiny-x4, 32x32, batch 4, forward: {:.0} ms",
        median(|| drop(unet.forward(&frozen, &text)))
    );
    let training = median(|| {
        // Without a bound nothing is computed twice, as in PyTorch, beside which the time is put.
        let (y, tape) = unet.forward_train(&adapted, &text, usize::MAX);
        drop(unet.backward(
            &adapted,
            &text,
            tape,
            &scale(&y, 2.0 / y.len() as f32),
            true,
        ));
    });
    println!("tiny-x4, 32x32, batch 4, LoRA forward and backward: {training:.0} ms");
    let latent = rng.normals(2, &[1, 16, 48, 64], &device);
    println!(
        "tiny-x4, decode to 256x192: {:.0} ms",
        median(|| drop(prior.vae.decode(&latent)))
    );
    Ok(())
}
