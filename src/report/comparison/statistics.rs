//! Means, spreads, and differences of pairs with their intervals. Knows only numbers.

use serde::Serialize;

/// A difference of pairs: of the same views, scored for two arms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Paired {
    /// The mean difference.
    pub mean: f64,
    /// Where its 95 % interval begins and ends: Student's, over the pairs. `None` where there are
    /// fewer than two.
    pub interval: Option<[f64; 2]>,
    /// In how many pairs the first is better.
    pub better: usize,
    /// How many pairs there are.
    pub pairs: usize,
}

impl Paired {
    /// `+0.310 [+0.120, +0.500] 14/18`.
    pub fn text(&self) -> String {
        format!("{} {}/{}", self.range(), self.better, self.pairs)
    }

    /// `+0.310 [+0.120, +0.500]`.
    pub fn range(&self) -> String {
        let ends = self.interval.unwrap_or_default();
        let largest = ends
            .map(f64::abs)
            .into_iter()
            .fold(self.mean.abs(), f64::max);
        // As many decimals for all as show three digits of the largest: more of a small mean between
        // wide ends would say nothing.
        let decimals = if largest > 0.0 {
            (2.0 - largest.log10().floor()).clamp(0.0, 8.0) as usize
        } else {
            0
        };
        let interval = self.interval.map_or(String::new(), |[low, high]| {
            format!(" [{low:+.decimals$}, {high:+.decimals$}]")
        });
        format!("{:+.decimals$}{interval}", self.mean)
    }
}

/// Which way a metric is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// Up.
    Higher,
    /// Down.
    Lower,
}

impl Better {
    /// Which way a metric's definition says that it is better, if either.
    pub fn of(definition: &str) -> Option<Self> {
        if definition.contains("higher is") {
            Some(Self::Higher)
        } else if definition.contains("lower is") {
            Some(Self::Lower)
        } else {
            None
        }
    }

    /// Whether the first value is better than the second.
    pub fn beats(self, first: f64, second: f64) -> bool {
        match self {
            Self::Higher => first > second,
            Self::Lower => first < second,
        }
    }
}

/// The mean; `None` of nothing.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The standard deviation of a sample (n - 1); `None` of fewer than two.
pub fn spread(values: &[f64]) -> Option<f64> {
    let mean = mean(values).filter(|_| values.len() > 1)?;
    // In two passes: the mean of squares less the square of the mean would cancel.
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt())
}

/// What the first of each pair has ahead of the second; `None` where there are no pairs.
pub fn paired(pairs: &[(f64, f64)], better: Better) -> Option<Paired> {
    let differences: Vec<f64> = pairs.iter().map(|(a, b)| a - b).collect();
    let mean = mean(&differences)?;
    let interval = spread(&differences).map(|spread| {
        let count = differences.len();
        // Student's quantile, since there are a handful of views: the normal one would make
        // intervals too narrow.
        let half = student_95(count - 1) * spread / (count as f64).sqrt();
        [mean - half, mean + half]
    });
    let wins = pairs.iter().filter(|(a, b)| better.beats(*a, *b));
    Some(Paired {
        mean,
        interval,
        better: wins.count(),
        pairs: pairs.len(),
    })
}

/// The 97.5 % quantile of Student's distribution: exact to four digits for few degrees of freedom,
/// and from there by Cornish and Fisher's series about the normal one.
fn student_95(freedom: usize) -> f64 {
    const FEW: [f64; 8] = [
        12.7062, 4.3027, 3.1824, 2.7764, 2.5706, 2.4469, 2.3646, 2.3060,
    ];
    // The limit for many degrees of freedom.
    const NORMAL: f64 = 1.959_963_985;
    // The series is off by 3 at one degree of freedom, and by less than 3e-4 from nine on.
    if let Some(exact) = freedom.checked_sub(1).and_then(|at| FEW.get(at)) {
        return *exact;
    }
    let [z, n] = [NORMAL, freedom as f64];
    // Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.5.
    let first = (z.powi(3) + z) / 4.0;
    let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
    let third = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
    z + first / n + second / n.powi(2) + third / n.powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against `scipy.stats.t.ppf(0.975, n)`.
    #[test]
    fn quantiles_are_those_of_tables() {
        let known = [
            (1, 12.7062),
            (3, 3.1824),
            (6, 2.4469),
            (9, 2.2622),
            (17, 2.1098),
            (100, 1.9840),
        ];
        for (freedom, quantile) in known {
            let value = student_95(freedom);
            assert!((value - quantile).abs() < 1e-3, "{freedom}: {value}");
        }
    }

    /// Against `scipy.stats.ttest_rel([24, 25, 27, 26], [23, 25, 25, 23]).confidence_interval()`.
    #[test]
    fn a_difference_of_pairs_has_the_interval_of_the_paired_test() {
        let pairs = [(24.0, 23.0), (25.0, 25.0), (27.0, 25.0), (26.0, 23.0)];
        let found = paired(&pairs, Better::Higher).unwrap();
        assert_eq!((found.mean, found.better, found.pairs), (1.5, 3, 4));
        let [low, high] = found.interval.unwrap();
        assert!(
            (low + 0.554_26).abs() < 1e-3 && (high - 3.554_26).abs() < 1e-3,
            "{low} {high}"
        );
        assert_eq!(paired(&pairs, Better::Lower).unwrap().better, 0);
    }

    #[test]
    fn one_value_has_no_spread_and_one_pair_no_interval() {
        assert_eq!((mean(&[]), spread(&[3.0])), (None, None));
        assert_eq!(spread(&[1.0, 3.0]), Some(2f64.sqrt()));
        assert_eq!(
            paired(&[(1.0, 0.5)], Better::Higher).unwrap().interval,
            None
        );
        assert_eq!(paired(&[], Better::Higher), None);
    }

    #[test]
    fn a_definition_says_which_way_is_better() {
        assert_eq!(
            Better::of("PSNR in dB; higher is better"),
            Some(Better::Higher)
        );
        assert_eq!(Better::of("FLIP; lower is better"), Some(Better::Lower));
        assert_eq!(Better::of("a share"), None);
    }

    #[test]
    fn a_difference_and_its_interval_have_as_many_decimals_as_say_something() {
        let text = |mean, interval| {
            let paired = Paired {
                mean,
                interval,
                better: 2,
                pairs: 3,
            };
            paired.text()
        };
        assert_eq!(
            text(0.005_552, Some([-0.020_28, 0.031_38])),
            "+0.0056 [-0.0203, +0.0314] 2/3"
        );
        assert_eq!(
            text(-10.37, Some([-14.02, -6.726])),
            "-10.4 [-14.0, -6.7] 2/3"
        );
        assert_eq!(text(0.5, None), "+0.500 2/3");
        assert_eq!(text(0.0, Some([0.0, 0.0])), "+0 [+0, +0] 2/3");
    }
}
