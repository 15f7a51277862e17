//! The embedded scene: the same bits however it is made, a truth at any resolution, and worth
//! super-resolving.
#![allow(clippy::unwrap_used)] // The helpers of tests are tests too.

use compute::Device;
use compute::resize::{Filter, resize};
use formats::color::srgb_to_linear;
use scene::{Photo, Reducer, SceneData, downscale, still_life};

fn with_threads(threads: usize, make: impl Fn() -> SceneData + Send + Sync) -> SceneData {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
        .install(make)
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let make = || still_life(2, (48, 36), 2, 7);
    assert_eq!(with_threads(1, make), with_threads(3, make));
}

#[test]
fn the_seed_moves_things_and_cameras_a_little() {
    let a = still_life(1, (64, 48), 2, 0);
    let b = still_life(1, (64, 48), 2, 1);
    let here = &a.photos[0].camera;
    let there = &b.photos[0].camera;
    let moved = here.position().distance(there.position());
    assert!(moved > 1e-4 && moved < 0.2, "{moved}");
    assert_ne!(a.photos[0].pixels.rgb, b.photos[0].pixels.rgb);
}

#[test]
fn photos_are_named_in_order_and_share_near_and_far() {
    let scene = still_life(12, (24, 18), 1, 0);
    let names: Vec<_> = scene
        .photos
        .iter()
        .map(|photo| photo.name.as_str())
        .collect();
    assert!(
        names.is_sorted() && names[0] == "view_000" && names[11] == "view_011",
        "{names:?}"
    );
    let first = &scene.photos[0].camera;
    assert!(
        first.near > 1.0 && first.far < 8.0,
        "{} {}",
        first.near,
        first.far
    );
    for photo in &scene.photos {
        assert_eq!(
            (photo.camera.near, photo.camera.far),
            (first.near, first.far)
        );
        assert_eq!(photo.pixels.rgb.len(), 24 * 18 * 3);
        assert!(
            photo
                .pixels
                .rgb
                .iter()
                .all(|value| (0.0..=1.0).contains(value))
        );
        assert!(
            photo.camera.position().z > scene.bounds[1][2],
            "the cameras stand before the box"
        );
    }
    let size: Vec<f64> = (0..3)
        .map(|axis| scene.bounds[1][axis] - scene.bounds[0][axis])
        .collect();
    assert!(
        size.iter().all(|side| (1.0..6.0).contains(side)),
        "{size:?}"
    );
}

/// A pixel is the mean of its area: the same rays, cut into fewer pixels, must give the same light.
#[test]
fn fewer_pixels_with_more_samples_agree_with_more_pixels() {
    let fine = still_life(1, (128, 96), 4, 0);
    let coarse = still_life(1, (64, 48), 8, 0);
    let linear = |photo: &Photo| {
        photo
            .pixels
            .rgb
            .iter()
            .map(|value| srgb_to_linear(*value))
            .collect::<Vec<_>>()
    };
    let fine = linear(&fine.photos[0]);
    let coarse = linear(&coarse.photos[0]);
    let mut differences = Vec::new();
    for (y, x) in (0..48).flat_map(|y| (0..64).map(move |x| (y, x))) {
        for channel in 0..3 {
            let at = |dy, dx| fine[3 * ((2 * y + dy) * 128 + 2 * x + dx) + channel];
            let mean = (at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1)) / 4.0;
            differences.push((mean - coarse[3 * (y * 64 + x) + channel]).abs());
        }
    }
    // Not zero: which sample looks at which point of a light differs, and highlights are clipped
    // after the mean.
    let mean = differences.iter().sum::<f32>() / differences.len() as f32;
    let most = differences.iter().copied().fold(0.0, f32::max);
    println!("mean difference {mean:.5}, most {most:.3}");
    assert!(mean < 2e-3 && most < 0.15, "mean {mean}, most {most}");
}

fn psnr(a: &[f32], b: &[f32]) -> f32 {
    let square: f32 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>() / a.len() as f32;
    -10.0 * square.log10()
}

fn enlarged(photo: &Photo, width: usize, height: usize) -> Vec<f32> {
    let w = photo.camera.width as usize;
    let h = photo.camera.height as usize;
    let image = Device::cpu().array(&[1, h, w, 3], photo.pixels.rgb.clone());
    let planes: Vec<f32> = (0..3)
        .flat_map(|c| image.to_vec().into_iter().skip(c).step_by(3))
        .collect();
    let image = Device::cpu().array(&[1, 3, h, w], planes);
    let large = resize(&image, height, width, Filter::BicubicPil, false).to_vec();
    (0..width * height)
        .flat_map(|i| [0, 1, 2].map(|c| large[c * width * height + i]))
        .collect()
}

#[test]
fn a_quarter_of_the_size_loses_detail_that_a_half_mostly_keeps() {
    let scene = still_life(1, (256, 192), 4, 0);
    let photo = &scene.photos[0];
    let kept = |factor| {
        psnr(
            &photo.pixels.rgb,
            &enlarged(
                &downscale(photo, factor, Reducer::Bicubic).unwrap(),
                256,
                192,
            ),
        )
    };
    let quarter = kept(4);
    let half = kept(2);
    println!("bicubic down and up again: x4 {quarter:.2} dB, x2 {half:.2} dB");
    assert!((15.0..24.0).contains(&quarter), "x4: {quarter} dB");
    assert!(half > quarter + 2.5, "x2: {half} dB, x4: {quarter} dB");
}
