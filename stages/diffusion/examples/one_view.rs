//! One photo, one round: how far RSD, SDS or VSD come from bicubic interpolation, with the embedded
//! prior.
//!
//! `cargo run --release -p diffusion --example one_view -- photo.png 256x192 '{"guidance": {"Rsd":
//! {}}, "steps": 100}' ..`
//!
//! The photo's centre is shrunk to a quarter and brought back. Every quarter of the steps it prints
//! PSNR to the photo, in brackets that of the shrunk result to the shrunk photo, and the same after
//! three rounds of back-projection.

use std::error::Error;
use std::path::Path;

use compute::elementwise::{add, clamp, scale, sub};
use compute::resize::{Filter, resize};
use compute::{Array, Device, reduce};
use diffusion::optimize::{Optimization, Options, Residual, ViewLatents};
use diffusion::{ModelSource, Prior};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, size, options @ ..] = arguments.as_slice() else {
        return Err("usage: PHOTO WIDTHxHEIGHT [OPTIONS..]".into());
    };
    let trial = Trial::new(&centre(Path::new(path), size)?)?;
    trial.report("bicubic", &trial.interpolated);
    for options in options {
        trial.run(options)?;
    }
    Ok(())
}

/// A photo, what is left of it at a quarter of its size, and that brought back; `[1, 3, H, W]` in
/// [-1, 1].
struct Trial {
    prior: Prior,
    photo: Array,
    low: Array,
    interpolated: Array,
    /// The interpolated photo's latent, scaled.
    latent: Array,
}

impl Trial {
    fn new(photo: &Array) -> Result<Self, Box<dyn Error>> {
        let prior = Prior::load(&ModelSource::Embedded, &Device::cpu())?;
        let low = shrink(photo);
        let interpolated = enlarge(&low);
        let latent = scale(
            &prior.vae.encode(&interpolated).mean,
            prior.vae.scaling_factor() as f32,
        );
        Ok(Self {
            prior,
            photo: photo.clone(),
            low,
            interpolated,
            latent,
        })
    }

    fn run(&self, text: &str) -> Result<(), Box<dyn Error>> {
        let options: Options = serde_json::from_str(text)?;
        let denoiser = self
            .prior
            .denoiser(&options.prompt, &options.negative_prompt);
        let views = [self.view()];
        let mut optimization = Optimization::new(&denoiser, &views, &options, 0)?;
        while !optimization.is_done() {
            let log = optimization.step()?;
            let guided = (log.step + 1).saturating_sub(options.warm_up().into());
            if guided > 0 && guided % u64::from(options.steps.div_ceil(4)) == 0 {
                self.report(
                    &format!("{text} after {guided}"),
                    &self.upscaled(&optimization.state().residuals[0]),
                );
            }
        }
        Ok(())
    }

    fn view(&self) -> ViewLatents {
        let map = |x: &Array| x.reshape(&x.shape()[1..]);
        ViewLatents {
            name: "photo".into(),
            latent: map(&self.latent),
            low: map(&self.low),
            mask: None,
            camera: [0.0; 16],
        }
    }

    /// Residual decoding: what the residual adds to the decoded latent is added to the interpolated
    /// photo.
    fn upscaled(&self, residual: &Residual) -> Array {
        let decode = |latent| {
            self.prior
                .vae
                .decode(&scale(latent, 1.0 / self.prior.vae.scaling_factor() as f32))
        };
        let residual = Device::cpu().array(self.latent.shape(), residual.values.clone());
        let gain = sub(
            &decode(&add(&self.latent, &residual)),
            &decode(&self.latent),
        );
        add(&self.interpolated, &gain)
    }

    fn report(&self, name: &str, image: &Array) {
        let line = |x: &Array| {
            format!(
                "{:.2} ({:.1})",
                psnr(x, &self.photo),
                psnr(&shrink(x), &self.low)
            )
        };
        // Back-projection as `Decode` has it: what the reduction lacks beside the low-resolution
        // photo is enlarged and added.
        let projected = (0..3).fold(image.clone(), |x, _| {
            clamp(&add(&x, &enlarge(&sub(&self.low, &shrink(&x)))), -1.0, 1.0)
        });
        println!(
            "{} back-projected {}  {name}",
            line(image),
            line(&projected)
        );
    }
}

/// The centre of a picture, `[1, 3, H, W]` in [-1, 1].
fn centre(path: &Path, size: &str) -> Result<Array, Box<dyn Error>> {
    let (width, height) = size
        .split_once('x')
        .ok_or("the size must read like 256x192")?;
    let width: u32 = width.parse()?;
    let height: u32 = height.parse()?;
    let photo = image::open(path)?.to_rgb8();
    let at = |x: u32, y: u32| {
        photo.get_pixel(
            x + (photo.width() - width) / 2,
            y + (photo.height() - height) / 2,
        )
    };
    let values =
        (0..3).flat_map(|c| (0..height).flat_map(move |y| (0..width).map(move |x| (c, x, y))));
    let values = values
        .map(|(c, x, y)| f32::from(at(x, y)[c]) / 127.5 - 1.0)
        .collect();
    Ok(Device::cpu().array(&[1, 3, height as usize, width as usize], values))
}

fn shrink(x: &Array) -> Array {
    resize(
        &clamp(x, -1.0, 1.0),
        x.shape()[2] / 4,
        x.shape()[3] / 4,
        Filter::BicubicTorch,
        true,
    )
}

fn enlarge(x: &Array) -> Array {
    resize(
        x,
        x.shape()[2] * 4,
        x.shape()[3] * 4,
        Filter::BicubicTorch,
        false,
    )
}

/// In decibels, over all pixels and channels.
fn psnr(x: &Array, y: &Array) -> f64 {
    // PSNR refers to a peak of 1. The range [-1, 1] is twice as wide, so squares are four times too
    // large.
    let error = f64::from(reduce::mean_square(&sub(&clamp(x, -1.0, 1.0), y))) / 4.0;
    -10.0 * error.log10()
}
