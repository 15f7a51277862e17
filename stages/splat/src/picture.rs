//! Pictures that splats are made of and compared with. Knows no splats.

use formats::Camera;

/// What a camera sees: colours in front of black, and how much of a pixel is covered.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Red, green, blue (sRGB-encoded, times coverage) and coverage: one for each pixel, by rows.
    pub pixels: Vec<[f32; 4]>,
}

impl Picture {
    /// A picture of colours and coverage.
    pub fn new(rgb: &[f32], coverage: &[f32]) -> Self {
        let colors = rgb.chunks_exact(3).zip(coverage);
        Self {
            pixels: colors
                .map(|(c, covered)| [c[0], c[1], c[2], *covered])
                .collect(),
        }
    }

    /// The colours alone, in front of black.
    pub fn rgb(&self) -> impl Iterator<Item = f32> + '_ {
        self.pixels.iter().flat_map(|[r, g, b, _]| [*r, *g, *b])
    }
}

/// How near colours are to others, in dB: the peak is 1. What lies outside 0 to 1 is clipped.
pub fn psnr(ours: impl Iterator<Item = f32>, theirs: impl Iterator<Item = f32>) -> f64 {
    let mut sum = 0.0;
    let mut count = 0_u32;
    for (a, b) in ours.zip(theirs) {
        let apart = f64::from(a.clamp(0.0, 1.0)) - f64::from(b.clamp(0.0, 1.0));
        sum += apart * apart;
        count += 1;
    }
    -10.0 * (sum / f64::from(count.max(1))).log10()
}

/// The camera without its lens: what splats are drawn for. Fields are asked for the same.
pub fn pinhole(camera: &Camera) -> Camera {
    Camera {
        distortion: formats::Distortion::default(),
        ..*camera
    }
}
