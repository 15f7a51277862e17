//! The autoencoder on images of any size.

use crate::support::distance;
use compute::elementwise::sub;
use compute::reduce::mean_square;
use compute::shape::{crop, pad_reflect};
use compute::{Array, Device};
use diffusion::{ModelSource, Prior, Vae};

fn vae() -> Vae {
    Prior::load(&ModelSource::Embedded, &Device::cpu())
        .unwrap()
        .vae
}

/// A smooth picture in [-1, 1].
fn picture(height: usize, width: usize) -> Array {
    let pixel = |i: usize| {
        let c = i / (height * width);
        let y = i / width % height;
        let x = i % width;
        ((x as f32 * 0.11 + c as f32).sin() + (y as f32 * 0.07 - x as f32 * 0.02).cos()) / 2.0
    };
    Device::cpu().array(
        &[1, 3, height, width],
        (0..3 * height * width).map(pixel).collect(),
    )
}

#[test]
fn a_picture_of_odd_size_comes_back_in_its_size() {
    let vae = vae();
    let image = picture(47, 63);
    let latent = vae.encode_image(&image, 512);
    assert_eq!((vae.factor(), latent.shape()), (4, &[1, 16, 12, 16][..]));
    let whole = vae.encode(&pad_reflect(&image, [0, 1, 0, 1])).mean;
    assert_eq!(
        latent.to_vec(),
        whole.to_vec(),
        "the scaling factor of tiny-x4 is 1"
    );
    let decoded = vae.decode_latent(&latent, [47, 63], 512);
    assert_eq!(
        decoded.to_vec(),
        crop(&vae.decode(&whole), 0, 0, 47, 63).to_vec()
    );
    // Its model card gives the round trip 36.6 dB.
    let psnr = -10.0 * (f64::from(mean_square(&sub(&decoded, &image))) / 4.0).log10();
    assert!(psnr > 34.0, "the picture comes back at {psnr:.1} dB");
}

#[test]
fn pictures_smaller_than_a_latent_pixel_come_back_in_their_size() {
    let vae = vae();
    for [height, width] in [[1, 1], [1, 3], [2, 1], [3, 2], [2, 9], [5, 1]] {
        let latent = vae.encode_image(&picture(height, width), 512);
        assert_eq!(
            latent.shape(),
            [1, 16, height.div_ceil(4), width.div_ceil(4)]
        );
        let decoded = vae.decode_latent(&latent, [height, width], 512);
        assert!(
            decoded.shape() == [1, 3, height, width]
                && decoded.to_vec().iter().all(|v| v.is_finite())
        );
    }
}

#[test]
fn tiles_change_little_and_leave_no_seam() {
    let vae = vae();
    let image = picture(96, 160);
    let whole = vae.encode_image(&image, 512);
    let tiled = vae.encode_image(&image, 64);
    let off = distance(&tiled, &whole);
    assert!(
        off > 0.0 && off < 0.2,
        "the latent is off by {off} of its norm"
    );
    let decoded = vae.decode_latent(&tiled, [96, 160], 64);
    let off = distance(&decoded, &vae.decode_latent(&tiled, [96, 160], 512));
    assert!(off < 0.1, "the picture is off by {off} of its norm");
    let steps = |x: &Array| {
        let values = x.to_vec();
        let step = |row: &[f32]| {
            row.windows(2)
                .map(|p| (p[1] - p[0]).abs())
                .fold(0.0, f32::max)
        };
        values.chunks(160).map(step).fold(0.0, f32::max)
    };
    let tiled = steps(&decoded);
    let whole = steps(&vae.decode_latent(&whole, [96, 160], 512));
    assert!(
        tiled < 1.2 * whole,
        "the steepest step is {tiled} with tiles and {whole} without"
    );
}
