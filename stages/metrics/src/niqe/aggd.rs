//! Fits the asymmetric generalised Gaussian distribution by matching moments (Lasmar, Stitou,
//! Berthoumieu 2009). Knows nothing of where the samples come from.

/// Shapes tried: 0.2 to 10 in steps of 0.001.
const SHAPES: usize = 9801;

/// The shape and the two scales of a fitted distribution; the scales are NaN if a side has no
/// samples.
pub(super) struct Aggd {
    /// 2 for a Gaussian, 1 for a Laplacian.
    pub alpha: f64,
    pub beta_left: f64,
    pub beta_right: f64,
}

impl Aggd {
    /// `(beta_right - beta_left) Gamma(2 / alpha) / Gamma(1 / alpha)` (Eq. 8).
    pub fn mean(&self) -> f64 {
        (self.beta_right - self.beta_left) * gamma(2.0 / self.alpha) / gamma(1.0 / self.alpha)
    }
}

/// The moment ratio `Gamma(2/a)^2 / (Gamma(1/a) Gamma(3/a))` of every shape tried.
pub(super) struct Shapes(Vec<f64>);

impl Shapes {
    pub fn new() -> Shapes {
        // Computed once for all blocks: it takes three gamma functions a shape.
        let ratio = |a: f64| gamma(2.0 / a).powi(2) / (gamma(1.0 / a) * gamma(3.0 / a));
        Shapes((0..SHAPES).map(|i| ratio(shape(i))).collect())
    }

    /// The distribution whose moments come nearest to those of `samples` (Eq. 7).
    pub fn fit(&self, samples: impl Iterator<Item = f32>) -> Aggd {
        let moments = Moments::of(samples);
        // Of a side without samples this is NaN, which reaches g, the target and that side's scale.
        let left = moments.left.root_mean();
        let right = moments.right.root_mean();
        let g = left / right;
        let r = moments.absolute.mean().powi(2) / moments.square.mean();
        let target = r * (g.powi(3) + 1.0) * (g + 1.0) / (g * g + 1.0).powi(2);
        let alpha = shape(self.nearest(target));
        // Turns deviation into scale: beta^2 = variance Gamma(1 / alpha) / Gamma(3 / alpha).
        let scale = (gamma(1.0 / alpha) / gamma(3.0 / alpha)).sqrt();
        Aggd {
            alpha,
            beta_left: left * scale,
            beta_right: right * scale,
        }
    }

    /// The first index whose ratio is nearest to `target`; the first of all for NaN, as numpy's
    /// `argmin` has it: a block without texture so counts with shape 0.2 in the mean.
    fn nearest(&self, target: f64) -> usize {
        let mut best = (0, f64::INFINITY);
        for (index, ratio) in self.0.iter().enumerate() {
            let distance = (ratio - target).powi(2);
            if distance < best.1 {
                best = (index, distance);
            }
        }
        best.0
    }
}

/// The shape at an index.
fn shape(index: usize) -> f64 {
    0.2 + 0.001 * index as f64
}

/// Sums over samples: squares of the negative ones, of the positive ones, of all, and magnitudes of
/// all.
#[derive(Default)]
struct Moments {
    left: Sum,
    right: Sum,
    square: Sum,
    absolute: Sum,
}

impl Moments {
    fn of(samples: impl Iterator<Item = f32>) -> Moments {
        let mut moments = Moments::default();
        for sample in samples.map(f64::from) {
            let square = sample * sample;
            moments.absolute.add(sample.abs());
            moments.square.add(square);
            // A zero lies on neither side but counts in the moments of all, as in the reference.
            match sample {
                x if x < 0.0 => moments.left.add(square),
                x if x > 0.0 => moments.right.add(square),
                _ => (),
            }
        }
        moments
    }
}

#[derive(Default)]
struct Sum {
    total: f64,
    count: usize,
}

impl Sum {
    fn add(&mut self, value: f64) {
        self.total += value;
        self.count += 1;
    }

    /// The mean of what was added; NaN if nothing was.
    fn mean(&self) -> f64 {
        self.total / self.count as f64
    }

    fn root_mean(&self) -> f64 {
        self.mean().sqrt()
    }
}

/// The gamma function of a positive number by Lanczos' series (g = 7, nine terms), to about 1e-14.
fn gamma(x: f64) -> f64 {
    // Arguments are 0.1 to 15 (k / alpha), where the series needs no reflection formula.
    const TERMS: [f64; 8] = [
        676.5203681218851,
        -1259.1392167224028,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507343278686905,
        -0.13857109526572012,
        9.984_369_578_019_572e-6,
        1.5056327351493116e-7,
    ];
    let x = x - 1.0;
    let series: f64 = TERMS
        .iter()
        .enumerate()
        .map(|(i, term)| term / (x + i as f64 + 1.0))
        .sum();
    // Here t = x + g + 1 / 2 with g = 7.
    let t = x + 7.5;
    std::f64::consts::TAU.sqrt() * t.powf(x + 0.5) * (-t).exp() * (0.999_999_999_999_809_9 + series)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gamma_meets_factorials_and_the_half() {
        for (x, expected) in [
            (1.0, 1.0),
            (5.0, 24.0),
            (15.0, 87_178_291_200.0),
            (0.5, std::f64::consts::PI.sqrt()),
        ] {
            assert!(
                (gamma(x) / expected - 1.0).abs() < 2e-14,
                "gamma({x}) = {}",
                gamma(x)
            );
        }
        assert!(
            (gamma(0.1) / 9.513507698668732 - 1.0).abs() < 2e-14,
            "{}",
            gamma(0.1)
        );
    }

    /// A Laplacian's quantiles, 3 times as wide to the right: shape 1 and scales 1 and 3 come back.
    #[test]
    fn a_laplacian_with_unequal_sides_is_recognised() {
        let quantile = |i: usize| -(1.0 - (i as f64 + 0.5) / 40_000.0).ln();
        let left = (0..10_000).map(|i| -quantile(4 * i) as f32);
        let right = (0..30_000).map(|i| 3.0 * quantile(4 * i / 3) as f32);
        let fit = Shapes::new().fit(left.chain(right));
        assert!((fit.alpha - 1.0).abs() < 0.01, "alpha {}", fit.alpha);
        assert!((fit.beta_left - 1.0).abs() < 0.02 && (fit.beta_right - 3.0).abs() < 0.06);
        assert!((fit.mean() - 2.0).abs() < 0.06, "{}", fit.mean());
    }

    #[test]
    fn without_samples_on_a_side_the_scale_is_not_a_number_and_the_shape_the_smallest() {
        let fit = Shapes::new().fit([0.0f32; 8].into_iter());
        assert!(fit.alpha == 0.2 && fit.beta_left.is_nan() && fit.beta_right.is_nan());
        assert!(
            Shapes::new()
                .fit([1.0f32; 8].into_iter())
                .beta_left
                .is_nan()
        );
    }
}
