//! The filters of FLIP: how the eye blurs each opponent channel, and where it sees edges and
//! points. All are sums of products of a kernel across and one down, which is how they are
//! computed; beyond the border the nearest pixel counts.

use std::f64::consts::PI;

use rayon::prelude::*;

/// How the eye blurs a channel: Gaussians, each with a weight a and a width b (in degrees squared).
pub struct Contrast {
    gaussians: &'static [[f64; 2]],
}

impl Contrast {
    /// Of luminance, red to green, and yellow to blue.
    pub const ALL: [Self; 3] = [
        // Table 1 of the paper, without the second Gaussians that it gives a weight of 0.
        Self {
            gaussians: &[[1.0, 0.0047]],
        },
        Self {
            gaussians: &[[1.0, 0.0053]],
        },
        Self {
            gaussians: &[[34.1, 0.04], [13.5, 0.025]],
        },
    ];

    /// The widest of all: kernels of all channels reach as far.
    const WIDEST: f64 = 0.04;

    /// A plane as the eye has it.
    pub fn blur(&self, plane: &[f64], width: usize, pixels_per_degree: f64) -> Vec<f64> {
        // Three deviations: exp(-pi^2 d^2 / b) has the variance b / (2 pi^2).
        let reach = 3.0 * (Self::WIDEST / (2.0 * PI * PI)).sqrt() * pixels_per_degree;
        // All channels share this radius: the reference cuts their tails at the same place.
        let reach = reach.ceil() as i32;
        let parts: Vec<(f64, Vec<f64>)> = self
            .gaussians
            .iter()
            .map(|[a, b]| {
                let at = |i: i32| {
                    let degrees = f64::from(i) / pixels_per_degree;
                    (-PI * PI * degrees * degrees / b).exp()
                };
                // The paper has sqrt(pi / b) once for both directions, so it is part of the weight.
                (a * (PI / b).sqrt(), (-reach..=reach).map(at).collect())
            })
            .collect();
        let sum = |kernel: &[f64]| kernel.iter().sum::<f64>();
        // A channel's kernel is the sum of its Gaussians, which all share one total.
        let total: f64 = parts
            .iter()
            .map(|(weight, kernel)| weight * sum(kernel) * sum(kernel))
            .sum();
        let mut blurred = vec![0.0; plane.len()];
        for (weight, kernel) in &parts {
            let part = filtered(plane, width, kernel, kernel);
            for (sum, value) in blurred.iter_mut().zip(part) {
                *sum += weight / total * value;
            }
        }
        blurred
    }
}

/// What the eye looks for.
#[derive(Clone, Copy)]
pub enum Feature {
    /// Where brightness changes: first derivatives of a Gaussian.
    Edges,
    /// Where something stands out: second derivatives.
    Points,
}

impl Feature {
    /// The width of the feature detectors in degrees.
    const WIDTH: f64 = 0.082;

    /// How much of the feature there is at each pixel of a plane, in any direction.
    pub fn magnitude(self, plane: &[f64], width: usize, pixels_per_degree: f64) -> Vec<f64> {
        let deviation = 0.5 * Self::WIDTH * pixels_per_degree;
        let reach = (3.0 * deviation).ceil() as i32;
        let gaussian = |x: f64| (-x * x / (2.0 * deviation * deviation)).exp();
        // Constant factors are left out: `normalized` cancels them.
        let derivative = |i: i32| {
            let x = f64::from(i);
            match self {
                Self::Edges => -x * gaussian(x),
                Self::Points => (x * x / (deviation * deviation) - 1.0) * gaussian(x),
            }
        };
        let smooth = normalized((-reach..=reach).map(|i| gaussian(f64::from(i))).collect());
        let derivative = normalized((-reach..=reach).map(derivative).collect());
        let across = filtered(plane, width, &derivative, &smooth);
        let down = filtered(plane, width, &smooth, &derivative);
        across.iter().zip(down).map(|(x, y)| x.hypot(y)).collect()
    }
}

/// A kernel whose positive weights sum to 1, and whose negative ones to -1.
fn normalized(kernel: Vec<f64>) -> Vec<f64> {
    // Each sign has its own sum, so that a sampled kernel answers to a flat area with 0.
    let positive: f64 = kernel.iter().filter(|weight| **weight > 0.0).sum();
    let negative: f64 = -kernel.iter().filter(|weight| **weight < 0.0).sum::<f64>();
    let weight = |weight: f64| weight / if weight > 0.0 { positive } else { negative };
    kernel
        .into_iter()
        .map(|w| if w == 0.0 { 0.0 } else { weight(w) })
        .collect()
}

/// A plane under a kernel across and one down, both of odd length.
fn filtered(plane: &[f64], width: usize, across: &[f64], down: &[f64]) -> Vec<f64> {
    let height = plane.len() / width;
    let clamped = |at: usize, offset: usize, reach: usize, length: usize| {
        (at + offset).saturating_sub(reach).min(length - 1)
    };
    let mut rows = vec![0.0; plane.len()];
    let reach = across.len() / 2;
    let pairs = rows.par_chunks_mut(width).zip(plane.par_chunks(width));
    pairs.for_each(|(row, source)| {
        for (x, value) in row.iter_mut().enumerate() {
            let taps = across.iter().enumerate();
            *value = taps
                .map(|(k, weight)| weight * source[clamped(x, k, reach, width)])
                .sum();
        }
    });
    let mut both = vec![0.0; plane.len()];
    let reach = down.len() / 2;
    both.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        // Taps outside, columns inside: memory is read by rows, and a sum still adds taps in order.
        for (k, weight) in down.iter().enumerate() {
            let from = clamped(y, k, reach, height) * width;
            for (value, source) in row.iter_mut().zip(&rows[from..from + width]) {
                *value += weight * source;
            }
        }
    });
    both
}
