//! Tiles, the ensemble, threads, and the embedded network.

use compute::resize::{Filter, resize};
use compute::{Array, Device};
use upsampler::{Options, Upsampler, UpsamplerSource};

use crate::support::{furthest, load, picture};

const WHOLE: Options = Options {
    tile: 4096,
    ensemble: false,
};
const TILED: Options = Options {
    tile: 128,
    ensemble: false,
};

#[test]
fn tiles_give_what_the_whole_image_gives() {
    let device = Device::cpu();
    // 137 and 301 are no multiples of anything; the blocks of RRDB reach 90 pixels, its margins 48.
    for (name, tolerance) in [
        ("residual-x4.safetensors", 4e-6),
        ("compact-x2.safetensors", 4e-6),
        ("span-x4.safetensors", 2e-5),
        ("ncnn-span-f32.param", 2e-5),
        ("rrdb-x2.safetensors", 1e-4),
    ] {
        let network = load(name, &device);
        let image = picture(137, 301, &device);
        let whole = network.enlarge(&image, WHOLE);
        let tiled = network.enlarge(&image, TILED);
        let error = furthest(&whole, &tiled);
        assert!(error < tolerance, "{name}: tiles are {error:.1e} off");
    }
}

#[test]
fn an_image_of_one_tile_is_not_tiled() {
    let device = Device::cpu();
    let network = load("compact-x4.safetensors", &device);
    let image = picture(128, 100, &device);
    assert_eq!(
        network.enlarge(&image, TILED).to_vec(),
        network.enlarge(&image, WHOLE).to_vec()
    );
}

#[test]
fn images_of_a_pixel_are_enlarged() {
    for name in [
        "rrdb-x1.safetensors",
        "residual-x4.safetensors",
        "span-x2.safetensors",
    ] {
        let network = load(name, &Device::cpu());
        for (h, w) in [(1, 1), (1, 5), (3, 2)] {
            let enlarged = network.enlarge(&picture(h, w, &Device::cpu()), TILED);
            assert_eq!(
                enlarged.shape(),
                [1, 3, h * network.scale(), w * network.scale()]
            );
        }
    }
}

#[test]
fn the_ensemble_treats_all_ways_alike() {
    let device = Device::cpu();
    let network = load("residual-x4.safetensors", &device);
    let image = picture(20, 20, &device);
    let options = Options {
        ensemble: true,
        ..WHOLE
    };
    let reversed = |x: &Array| {
        let mut values = x.to_vec();
        let row = x.shape()[3];
        values.chunks_mut(row).for_each(<[f32]>::reverse);
        device.array(x.shape(), values)
    };
    let plain = network.enlarge(&image, WHOLE);
    let mean = network.enlarge(&image, options);
    let mirrored = network.enlarge(&reversed(&image), options);
    assert!(
        furthest(&reversed(&mirrored), &mean) < 1e-5,
        "mirrored images give mirrored results"
    );
    assert!(furthest(&plain, &mean) > 1e-3, "which one pass does not");
}

#[test]
fn the_bits_are_the_same_for_any_number_of_threads() {
    let image = picture(70, 150, &Device::cpu());
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let network = Upsampler::load(&UpsamplerSource::Embedded, &Device::cpu()).unwrap();
            network
                .enlarge(
                    &image,
                    Options {
                        ensemble: true,
                        ..TILED
                    },
                )
                .to_vec()
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(3));
}

#[test]
fn the_embedded_network_is_nearer_to_the_picture_than_bicubic() {
    let device = Device::cpu();
    // Rings with edges a pixel wide.
    let value = |i: usize| {
        let y = (i / 240 % 160) as f32 - 70.0;
        let x = (i % 240) as f32 - 130.0;
        0.5 + ((y.hypot(x) % 40.0 - 20.0).abs() - 10.0).clamp(-0.5, 0.5) * 0.6
    };
    let picture = device.array(&[1, 3, 160, 240], (0..3 * 160 * 240).map(value).collect());
    let small = resize(&picture, 40, 60, Filter::BicubicTorch, true);
    let network = Upsampler::load(&UpsamplerSource::Embedded, &device).unwrap();
    let error = |x: &Array| -> f32 {
        x.to_vec()
            .iter()
            .zip(picture.to_vec())
            .map(|(a, b)| (a - b).powi(2))
            .sum()
    };
    let learned = error(&network.enlarge(&small, Options::default()));
    let bicubic = error(&resize(&small, 160, 240, Filter::BicubicTorch, false));
    assert!(learned < 0.9 * bicubic, "{learned} against {bicubic}");
}
