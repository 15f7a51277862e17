//! Fits a field to low-resolution photos and judges it on held-out photos at full resolution, for
//! choosing defaults: `cargo run --release -p nerf --example fit -- still_life [name=value ...]`,
//! or the folder of an LLFF scene.

use compute::Device;
use compute::resize::{Filter, resize};
use formats::pixels::{interleaved, planes};
use nerf::{Field, FieldConfig, RenderOptions, TrainOptions, TrainView, Trainer, render};
use scene::{Llff, Photo, Reader, Reducer, SceneData, downscale, split_holdout, still_life};
use std::error::Error;
use std::time::Instant;

struct Settings {
    config: FieldConfig,
    options: TrainOptions,
    supersample: u32,
    factor: u32,
    size: (u32, u32),
    render: RenderOptions,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let source = arguments
        .next()
        .ok_or("name a scene: still_life or an LLFF folder")?;
    let mut settings = Settings {
        config: FieldConfig::default(),
        options: TrainOptions::default(),
        supersample: 1,
        factor: 4,
        size: (252, 189),
        render: RenderOptions::default(),
    };
    for argument in arguments {
        let (name, value) = argument
            .split_once('=')
            .ok_or("settings look like name=value")?;
        set(&mut settings, name, value)?;
    }
    settings.config.check()?;
    let scene = match source.as_str() {
        "still_life" => still_life(24, (256, 192), 4, 0),
        folder => Llff {
            folder: folder.into(),
            images: Some("images_4".into()),
            size: Some(settings.size),
        }
        .read()?,
    };
    fit(scene, &settings)
}

fn set(settings: &mut Settings, name: &str, value: &str) -> Result<(), Box<dyn Error>> {
    let Settings {
        config,
        options,
        supersample,
        factor,
        size,
        render,
    } = settings;
    match name {
        "levels" => config.levels = value.parse()?,
        "table" => config.log2_table = value.parse()?,
        "base" => config.base_resolution = value.parse()?,
        "finest" => config.finest_resolution = value.parse()?,
        "cells" => config.occupancy_resolution = value.parse()?,
        "march" => config.march_steps = value.parse()?,
        "cone" => config.march_cone = Some(value.parse()?),
        "steps" => options.steps = value.parse()?,
        "samples" => options.samples = value.parse()?,
        "rate" => options.rate = value.parse()?,
        "final_rate" => options.final_rate = value.parse()?,
        "beta" => options.beta = value.parse()?,
        "distortion" => options.distortion = value.parse()?,
        "fog" => options.fog = value.parse()?,
        "fog_range" => options.fog_range = value.parse()?,
        "background" => options.random_background = value.parse()?,
        "supersample" => *supersample = value.parse()?,
        "factor" => *factor = value.parse()?,
        "width" => *size = (value.parse()?, value.parse::<u32>()? * 3 / 4),
        "render_supersample" => render.supersample = value.parse()?,
        _ => return Err(format!("no setting is called {name}").into()),
    }
    Ok(())
}

fn fit(scene: SceneData, settings: &Settings) -> Result<(), Box<dyn Error>> {
    let (train, test) = split_holdout(scene.photos, 8);
    let small = |photo: &Photo| downscale(photo, settings.factor, Reducer::Bicubic);
    let low = train.iter().map(small).collect::<Result<Vec<_>, _>>()?;
    let view = |photo: &Photo| TrainView {
        camera: photo.camera,
        pixels: photo.pixels.clone().into(),
        mask: None,
        weight: 1.0,
        supersample: settings.supersample,
    };
    let bounds = scene.bounds.map(|corner| corner.map(|x| x as f32));
    let field = Field::new(&settings.config, bounds, 0);
    let start = Instant::now();
    let mut trainer = Trainer::new(field, low.iter().map(view).collect(), &settings.options, 0);
    let mut samples = 0;
    for step in 1..=settings.options.steps {
        let stats = trainer.step();
        samples += stats.samples;
        if step.is_power_of_two() || step % 500 == 0 {
            let per_ray = stats.samples as f64 / stats.rays as f64;
            let seconds = start.elapsed().as_secs_f64();
            println!(
                "step {step}: {:.2} dB, {per_ray:.1} samples a ray, {seconds:.1} s",
                stats.psnr
            );
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    println!(
        "{} samples in {seconds:.1} s: {:.3} million a second",
        samples,
        samples as f64 / seconds / 1e6
    );
    let field = trainer.into_field();
    let averaged = RenderOptions {
        supersample: 2,
        ..settings.render.clone()
    };
    println!(
        "low-resolution training views: {:.2} dB",
        mean(&low, |photo| quality(&field, photo, &averaged))
    );
    let test_low = test.iter().map(small).collect::<Result<Vec<_>, _>>()?;
    println!(
        "held out, low resolution: {:.2} dB",
        mean(&test_low, |photo| quality(&field, photo, &averaged))
    );
    println!(
        "held out, full resolution: {:.2} dB",
        mean(&test, |photo| quality(&field, photo, &settings.render))
    );
    let enlarged = |(photo, low): (&Photo, &Photo)| {
        let image = render(&field, &low.camera, &averaged);
        psnr(&bicubic(&image.rgb, low, photo), &photo.pixels.rgb)
    };
    let pairs = test.iter().zip(&test_low);
    println!(
        "held out, enlarged low-resolution render: {:.2} dB",
        pairs.clone().map(enlarged).sum::<f64>() / test.len() as f64
    );
    let photos = pairs
        .map(|(photo, low)| psnr(&bicubic(&low.pixels.rgb, low, photo), &photo.pixels.rgb))
        .sum::<f64>();
    println!(
        "held out, enlarged low-resolution photo: {:.2} dB",
        photos / test.len() as f64
    );
    Ok(())
}

fn mean(photos: &[Photo], quality: impl Fn(&Photo) -> f64) -> f64 {
    photos.iter().map(quality).sum::<f64>() / photos.len() as f64
}

fn quality(field: &Field, photo: &Photo, options: &RenderOptions) -> f64 {
    psnr(
        &render(field, &photo.camera, options).rgb,
        &photo.pixels.rgb,
    )
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a
        .iter()
        .zip(b)
        .map(|(a, b)| f64::from((a - b) * (a - b)))
        .sum();
    -10.0 * (sum / a.len() as f64).log10()
}

/// `rgb` of the size of `from`, enlarged to the size of `to`.
fn bicubic(rgb: &[f32], from: &Photo, to: &Photo) -> Vec<f32> {
    let [w, h] = [from.camera.width as usize, from.camera.height as usize];
    let [width, height] = [to.camera.width as usize, to.camera.height as usize];
    let image = Device::cpu().array(&[1, 3, h, w], planes(rgb, 3));
    let large = resize(&image, height, width, Filter::BicubicPil, false).to_vec();
    let numbers = interleaved(&large, 3).into_iter();
    numbers.map(|value| value.clamp(0.0, 1.0)).collect()
}
