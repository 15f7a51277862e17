//! PSNR, SSIM and NIQE against scikit-image and BasicSR, on pictures beside `golden/metrics.py`;
//! FLIP against NVIDIA's own and SSIMULACRA2 against libjxl's, on the same pictures
//! (`golden/perceptual.py`). `niqe` is BasicSR as published; `niqe_double` is BasicSR with its
//! halving summed in double precision, as ours is.

#![allow(clippy::unwrap_used)] // the helpers of tests are tests too

use metrics::{Image, flip, niqe, psnr, ssim, ssimulacra2};
use serde_json::Value;

/// A picture that `metrics.py` draws, too.
struct Picture {
    width: usize,
    height: usize,
    rgb8: Vec<u8>,
}

impl Picture {
    fn read(name: &str) -> Picture {
        let path = format!("{}/tests/golden/{name}.png", env!("CARGO_MANIFEST_DIR"));
        let rgb = image::open(path).unwrap().into_rgb8();
        Picture {
            width: rgb.width() as usize,
            height: rgb.height() as usize,
            rgb8: rgb.into_raw(),
        }
    }

    /// `texture` of metrics.py: waves with noise, and a flat quarter that NIQE has no statistics
    /// for.
    fn texture(width: usize, height: usize) -> Picture {
        let value = |x: usize, y: usize, c: usize| match x < width / 2 && y < height / 2 {
            true => 200,
            false => {
                (x * x / 64 + y * 3 + c * 40) % 128
                    + (x * 7919 + y * 104_729 + c * 1_299_709 + x * y * 31) % 97
            }
        };
        let rgb8 = (0..width * height * 3)
            .map(|i| value(i / 3 % width, i / 3 / width, i % 3) as u8)
            .collect();
        Picture {
            width,
            height,
            rgb8,
        }
    }

    /// The picture that `degraded` of `metrics.py` makes of it.
    fn degraded(&self) -> Picture {
        let at =
            |x: usize, y: usize, c: usize| usize::from(self.rgb8[(y * self.width + x) * 3 + c]);
        let mixed = |x: usize, y: usize, c: usize| {
            (at(x, y, c) + at((x + self.width - 1) % self.width, y, c)) / 2
        };
        let value =
            |i: usize| mixed(i / 3 % self.width, i / 3 / self.width, i % 3) * 9 / 10 / 8 * 8;
        Picture {
            rgb8: (0..self.rgb8.len()).map(|i| value(i) as u8).collect(),
            ..*self
        }
    }

    /// The upper left part, whose sides are multiples of 32: it halves evenly five times.
    fn even(&self) -> Picture {
        let [width, height] = [self.width, self.height].map(|side| side / 32 * 32);
        let rows = self.rgb8.chunks_exact(3 * self.width).take(height);
        Picture {
            width,
            height,
            rgb8: rows.flat_map(|row| &row[..3 * width]).copied().collect(),
        }
    }

    fn floats(&self) -> Vec<f32> {
        self.rgb8
            .iter()
            .map(|&value| f32::from(value) / 255.0)
            .collect()
    }

    fn image<'a>(&self, rgb: &'a [f32]) -> Image<'a> {
        Image::new(self.width, self.height, rgb)
    }
}

fn assert_agrees_with_what_people_see(name: &str, truth: Picture) {
    let golden: Value = serde_json::from_str(include_str!("golden/perceptual.json")).unwrap();
    let golden = &golden[name];
    let near = |what: &str, value: f64, expected: &Value, tolerance: f64| {
        let expected = expected.as_f64().unwrap();
        assert!(
            (value - expected).abs() < tolerance,
            "{name} {what}: {value}, the reference says {expected}"
        );
    };
    let a = truth.floats();
    let b = truth.degraded().floats();
    let a = truth.image(&a);
    let b = truth.image(&b);
    let seen = flip(a, b);
    near("flip", seen.mean, &golden["flip"], 1e-4);
    let row = &seen.map[truth.height / 2 * truth.width..][..truth.width];
    let expected = golden["flip_row"].as_array().unwrap();
    assert_eq!(expected.len(), row.len().div_ceil(10));
    for (value, expected) in row.iter().step_by(10).zip(expected) {
        near("flip in a pixel", f64::from(*value), expected, 1e-3);
    }
    let score = ssimulacra2(a, b).unwrap();
    near("ssimulacra2", score, &golden["ssimulacra2_double"], 1e-9);
    // libjxl computes in single precision.
    near("ssimulacra2 of libjxl", score, &golden["ssimulacra2"], 0.02);
    assert_lies_among_the_references(name, &truth, &golden["ssimulacra2_turned"]);
}

/// By the formulas a picture has one score however it is turned and mirrored. libjxl gives eight, of
/// which none is more right than another: ours is to be one that it might have given.
fn assert_lies_among_the_references(name: &str, truth: &Picture, turned: &Value) {
    let [a, b] = [truth.even(), truth.degraded().even()];
    let score = ssimulacra2(a.image(&a.floats()), b.image(&b.floats())).unwrap();
    let turned = turned.as_array().unwrap().iter();
    let [mut least, mut most] = [f64::INFINITY, f64::NEG_INFINITY];
    for value in turned.map(|value| value.as_f64().unwrap()) {
        least = least.min(value);
        most = most.max(value);
    }
    assert!(
        (least..most).contains(&score),
        "{name}: {score}, but libjxl says {least} to {most}"
    );
}

#[test]
fn what_people_see_agrees() {
    for name in ["skyline", "portrait"] {
        assert_agrees_with_what_people_see(name, Picture::read(name));
    }
    assert_agrees_with_what_people_see("texture", Picture::texture(300, 200));
}

fn assert_agrees_with_the_references(name: &str, truth: Picture) {
    let golden: Value = serde_json::from_str(include_str!("golden/metrics.json")).unwrap();
    let near = |metric: &str, value: f64, tolerance: f64| {
        let expected = golden[name][metric].as_f64().unwrap();
        assert!(
            (value - expected).abs() < tolerance,
            "{name} {metric}: {value}, the reference says {expected}"
        );
    };
    let a = truth.floats();
    let b = truth.degraded().floats();
    let a = truth.image(&a);
    let b = truth.image(&b);
    near("psnr", psnr(a, b), 1e-5);
    near("ssim", ssim(a, b).unwrap(), 1e-6);
    let niqe_a = niqe(a).unwrap().value;
    let niqe_b = niqe(b).unwrap().value;
    near("niqe", niqe_a, 3e-3);
    near("niqe_degraded", niqe_b, 3e-3);
    near("niqe_double", niqe_a, 2e-6);
    near("niqe_degraded_double", niqe_b, 2e-6);
}

#[test]
fn a_skyline_agrees() {
    assert_agrees_with_the_references("skyline", Picture::read("skyline"));
}

/// Blocks of pure white have no statistics: the reference's treatment of them is followed as well.
#[test]
fn a_portrait_before_white_agrees() {
    assert_agrees_with_the_references("portrait", Picture::read("portrait"));
}

#[test]
fn a_synthetic_texture_agrees() {
    assert_agrees_with_the_references("texture", Picture::texture(300, 200));
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let picture = Picture::read("portrait");
    let a = picture.floats();
    let b = picture.degraded().floats();
    let a = picture.image(&a);
    let b = picture.image(&b);
    let with_threads = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            (
                ssim(a, b).map(f64::to_bits),
                niqe(a).map(|niqe| niqe.value.to_bits()),
                flip(a, b).mean.to_bits(),
                ssimulacra2(a, b).map(f64::to_bits),
            )
        })
    };
    assert_eq!(with_threads(1), with_threads(3));
}
