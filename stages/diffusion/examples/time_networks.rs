//! Prints the time of a UNet forward pass and of a LoRA training step of tiny-x4 at 64x48 latents.
//!
//! `time_networks.py MODEL_FOLDER` prints the same for PyTorch. Threads: `RAYON_NUM_THREADS`.

use std::time::Instant;

use compute::elementwise::scale;
use compute::{Array, Device, Rng};
use diffusion::{ModelError, ModelSource, Prior};

const RUNS: usize = 5;

/// The fastest of some runs, in milliseconds.
fn fastest(mut run: impl FnMut()) -> f64 {
    let time = |_| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64() * 1e3
    };
    (0..RUNS).map(time).fold(f64::INFINITY, f64::min)
}

fn main() -> Result<(), ModelError> {
    let device = Device::cpu();
    let prior = Prior::load(&ModelSource::Embedded, &device)?;
    let (unet, rng) = (&prior.unet, Rng::new(0, "timing"));
    let lora = unet.new_lora(4, 4.0, 0);
    for batch in [1, 2] {
        let sample = rng.normals(0, &[batch, 19, 48, 64], &device);
        let text: Array = prior.text(&vec!["high resolution, 4K, photo"; batch]);
        let camera = rng.normals(1, &[batch, 16], &device);
        let (t, levels) = (vec![500; batch], vec![20; batch]);
        let forward = fastest(|| drop(unet.forward(&sample, &t, &text, &levels, None, None)));
        let training = fastest(|| {
            let (y, tape) = unet.forward_train(&sample, &t, &text, &levels, Some(&lora), Some(&camera));
            drop(unet.backward(tape, &scale(&y, 2.0 / y.len() as f32), false));
        });
        println!("batch {batch}: forward {forward:.0} ms, LoRA forward and backward {training:.0} ms");
    }
    let latent = rng.normals(2, &[1, 16, 48, 64], &device);
    println!("decode to 256x192: {:.0} ms", fastest(|| drop(prior.vae.decode(&latent))));
    Ok(())
}
