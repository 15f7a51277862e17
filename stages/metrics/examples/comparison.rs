//! Draws a comparison of three ways to enlarge a photo four times, with their metrics.
//!
//!     cargo run --release -p metrics --example comparison -- photo.png comparison.png

use compute::resize::{Filter, resize};
use compute::{Array, Device};
use metrics::{Image, Panel, comparison, niqe, psnr, psnr_lr_consistency, ssim};
use std::error::Error;

const FACTOR: usize = 4;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [photo, target] = arguments.as_slice() else {
        return Err("usage: comparison PHOTO.png COMPARISON.png".into());
    };
    let photo = image::open(photo)?.into_rgb8();
    // Whole low-resolution pixels only, so that enlarging them gives the same size.
    let width = photo.width() as usize / FACTOR * FACTOR;
    let height = photo.height() as usize / FACTOR * FACTOR;
    let photo = image::imageops::crop_imm(&photo, 0, 0, width as u32, height as u32).to_image();
    let truth: Vec<f32> = photo
        .into_raw()
        .into_iter()
        .map(|value| f32::from(value) / 255.0)
        .collect();
    let truth_image = Image::new(width, height, &truth);

    let low = resize(
        &planes(&truth, width, height),
        height / FACTOR,
        width / FACTOR,
        Filter::BicubicPil,
        true,
    );
    let low_rgb = interleaved(&low);
    let enlarged = |filter| interleaved(&resize(&low, height, width, filter, false));
    let methods = [
        ("nearest", enlarged(Filter::Nearest)),
        ("bilinear", enlarged(Filter::Bilinear)),
        ("bicubic", enlarged(Filter::BicubicPil)),
    ];

    println!(
        "{:>9} {:>8} {:>8} {:>8} {:>20}",
        "", "psnr_hr", "ssim_hr", "niqe_y", "psnr_lr_consistency"
    );
    let mut notes = Vec::new();
    for (label, rgb) in &methods {
        let image = Image::new(width, height, rgb);
        let psnr = psnr(truth_image, image);
        let consistency =
            psnr_lr_consistency(image, Image::new(width / FACTOR, height / FACTOR, &low_rgb));
        let ssim = ssim(truth_image, image).unwrap_or(f64::NAN);
        let niqe = niqe(image).map_or(f64::NAN, |n| n.value);
        println!("{label:>9} {psnr:>8.2} {ssim:>8.4} {niqe:>8.3} {consistency:>20.2}");
        notes.push(format!("{psnr:.2} dB"));
    }

    let shown = methods.iter().zip(&notes);
    let panels = shown.map(|((label, rgb), note)| Panel {
        label,
        note,
        image: Image::new(width, height, rgb),
    });
    let truth = Panel {
        label: "truth",
        note: "",
        image: truth_image,
    };
    let figure = comparison(&std::iter::once(truth).chain(panels).collect::<Vec<_>>());
    let width = figure.width as u32;
    let height = figure.height as u32;
    Ok(image::save_buffer(
        target,
        &figure.rgb8,
        width,
        height,
        image::ExtendedColorType::Rgb8,
    )?)
}

/// Interleaved colours as an array [1, 3, height, width].
fn planes(rgb: &[f32], width: usize, height: usize) -> Array {
    let pixels = width * height;
    Device::cpu().array(
        &[1, 3, height, width],
        (0..3 * pixels)
            .map(|i| rgb[i % pixels * 3 + i / pixels])
            .collect(),
    )
}

/// An array [1, 3, height, width] as interleaved colours.
fn interleaved(planes: &Array) -> Vec<f32> {
    let values = planes.to_vec();
    let pixels = planes.len() / 3;
    (0..3 * pixels)
        .map(|i| values[i % 3 * pixels + i / 3])
        .collect()
}
