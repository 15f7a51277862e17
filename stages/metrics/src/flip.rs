//! FLIP, the difference that a person sees when two pictures are shown one after the other in the
//! same place (Andersson et al. 2020, <https://doi.org/10.1145/3406183>), for pictures of low
//! dynamic range. Knows nothing of what they show.
//!
//! Names and constants are those of the paper; the colour spaces are in [`color`], the filters in
//! [`filters`].

mod color;
mod filters;

use rayon::prelude::*;

use crate::Image;
use color::{Lab, Opponent};
use filters::{Contrast, Feature};

/// Pixels in a degree of the visual field: a 4K screen 0.7 m wide, seen from 0.7 m.
// Distance times pixels per metre is pixels per radian, near the middle of the view.
const PIXELS_PER_DEGREE: f64 = 0.7 * 3840.0 / 0.7 * std::f64::consts::PI / 180.0;

/// Colour differences are compressed by this exponent.
const Q_C: f64 = 0.7;
/// The share of the largest difference below which differences count as small.
const P_C: f64 = 0.4;
/// Small differences are mapped to 0 up to this, the others from there to 1.
const P_T: f64 = 0.95;
/// Feature differences are compressed by this exponent.
const Q_F: f64 = 0.5;

/// What FLIP says of two pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Flip {
    /// The mean over all pixels, 0 to 1; 0 for identical pictures.
    pub mean: f64,
    /// The difference seen at each pixel, 0 to 1, rows first.
    pub map: Vec<f32>,
}

/// FLIP of `image` against `truth`: sRGB-encoded, clamped to 0..1, at 67 pixels per degree.
/// Symmetric.
///
/// Colours are compared after the contrast sensitivity of the eye at that distance has blurred
/// them, and edges and points where only one picture has them weigh more. Panics if the sizes
/// differ.
pub fn flip(truth: Image, image: Image) -> Flip {
    truth.assert_same_size(&image, "flip");
    let (a, b) = rayon::join(|| Seen::new(truth), || Seen::new(image));
    // After the clamp to the screen's colours no difference is larger than this one.
    // Compressed like all others, so that it is mapped to 1.
    let largest = compressed(color::largest_difference());
    let at = |i: usize| {
        let color = redistributed(compressed(a.colors[i].difference(&b.colors[i])), largest);
        let edges = (a.edges[i] - b.edges[i]).abs();
        let points = (a.points[i] - b.points[i]).abs();
        // Each kernel answers with at most 1, so a magnitude is at most sqrt(2).
        let feature = (edges.max(points) / std::f64::consts::SQRT_2).powf(Q_F);
        // Where one picture alone has a feature the exponent falls to 0, and any difference becomes
        // 1.
        color.powf(1.0 - feature.min(1.0))
    };
    let map: Vec<f64> = (0..a.colors.len()).into_par_iter().map(at).collect();
    // Collected before it is added up, so that the mean has one order for any number of threads.
    Flip {
        mean: map.iter().sum::<f64>() / map.len() as f64,
        map: map.into_iter().map(|value| value as f32).collect(),
    }
}

/// A picture as the eye has it.
struct Seen {
    colors: Vec<Lab>,
    edges: Vec<f64>,
    points: Vec<f64>,
}

impl Seen {
    fn new(image: Image) -> Self {
        let width = image.width();
        let pixels = || (0..image.height()).flat_map(|y| (0..width).map(move |x| (x, y)));
        let opponent: Vec<Opponent> = pixels()
            .map(|(x, y)| Opponent::of_srgb(image.pixel(x, y)))
            .collect();
        let plane = |channel: usize| opponent.iter().map(|color| color.0[channel]).collect();
        let planes: [Vec<f64>; 3] = [plane(0), plane(1), plane(2)];
        // 0 to 1, where edges and points are looked for.
        let luminance: Vec<f64> = planes[0].iter().map(|y| (y + 16.0) / 116.0).collect();
        let blurred: Vec<Vec<f64>> = Contrast::ALL
            .iter()
            .zip(&planes)
            .map(|(contrast, plane)| contrast.blur(plane, width, PIXELS_PER_DEGREE))
            .collect();
        let color = |i: usize| Opponent([blurred[0][i], blurred[1][i], blurred[2][i]]).lab();
        Self {
            colors: (0..opponent.len()).into_par_iter().map(color).collect(),
            edges: Feature::Edges.magnitude(&luminance, width, PIXELS_PER_DEGREE),
            points: Feature::Points.magnitude(&luminance, width, PIXELS_PER_DEGREE),
        }
    }
}

fn compressed(difference: f64) -> f64 {
    difference.powf(Q_C)
}

/// Differences from 0 to `largest` on 0 to 1, such that the smaller ones, of which there are most,
/// have most of the range.
fn redistributed(difference: f64, largest: f64) -> f64 {
    let knee = P_C * largest;
    if difference < knee {
        P_T / knee * difference
    } else {
        P_T + (difference - knee) / (largest - knee) * (1.0 - P_T)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(count: usize) -> Vec<f32> {
        (0..count * 3)
            .map(|i| (i * 37 % 101) as f32 / 101.0)
            .collect()
    }

    #[test]
    fn identical_pictures_do_not_differ_and_green_differs_from_blue_as_much_as_can_be() {
        let rgb = noise(32 * 24);
        let same = flip(Image::new(32, 24, &rgb), Image::new(32, 24, &rgb));
        assert_eq!(same.mean, 0.0);
        let green: Vec<f32> = [0.0, 1.0, 0.0].repeat(16 * 16);
        let blue: Vec<f32> = [0.0, 0.0, 1.0].repeat(16 * 16);
        let most = flip(Image::new(16, 16, &green), Image::new(16, 16, &blue));
        assert!((most.mean - 1.0).abs() < 1e-6, "{}", most.mean);
    }

    #[test]
    fn the_order_of_the_pictures_does_not_matter() {
        let rgb = noise(20 * 30);
        let other: Vec<f32> = rgb.iter().map(|value| value * 0.8).collect();
        let a = Image::new(20, 30, &rgb);
        let b = Image::new(20, 30, &other);
        assert!((flip(a, b).mean - flip(b, a).mean).abs() < 1e-12);
        assert!(
            flip(a, b)
                .map
                .iter()
                .all(|value| (0.0..=1.0).contains(value))
        );
    }
}
