//! Emission and absorption along one ray: weights, their sums, and the way back. Knows nothing of
//! what gave the densities.
//!
//! With alpha_i = 1 - exp(-sigma_i dt_i) and T_i the product of 1 - alpha_j over the samples before
//! i, a sample's weight is w_i = T_i alpha_i, and what is behind the last sample shows with weight
//! T_end (Max 1995; Mildenhall et al. 2020).

use crate::exponential::exp;

/// A ray is cut where less than this of what lies behind would show.
pub const CUT: f32 = 1e-4;

/// How many of a ray's next samples come before its transmittance falls below [`CUT`]. `depths` are
/// their sigma_i dt_i, and `optical_depth` is the sum over the samples before them, to which those
/// that are seen are added.
pub fn visible(depths: impl Iterator<Item = f32>, optical_depth: &mut f32) -> usize {
    // T < CUT is an optical depth above -ln CUT: sums instead of products of exponentials.
    let limit = -CUT.ln();
    depths
        .take_while(|depth| {
            // The sample that crosses the limit is still seen.
            let seen = *optical_depth <= limit;
            *optical_depth += depth;
            seen
        })
        .count()
}

/// Writes the weights w_i of a ray and returns T_end.
pub fn weights(sigma: &[f32], dt: &[f32], weights: &mut [f32]) -> f32 {
    let mut transmittance = 1.0;
    for ((weight, sigma), dt) in weights.iter_mut().zip(sigma).zip(dt) {
        // A difference of transmittances, not T (1 - exp(-sigma dt)): so weights and T_end add up
        // to 1 but for rounding.
        let next = transmittance * exp(-sigma * dt);
        *weight = transmittance - next;
        transmittance = next;
    }
    transmittance
}

/// The backward pass of [`weights`]: from the gradients to the weights and to T_end, the gradients
/// to sigma.
///
/// dL/dsigma_i = dt_i (T_{i+1} dL/dw_i - sum_{j>i} w_j dL/dw_j - T_end dL/dT_end).
pub fn weights_backward(
    dt: &[f32],
    weights: &[f32],
    end: f32,
    d_weights: &[f32],
    d_end: f32,
    d_sigma: &mut [f32],
) {
    // Both the transmittance and the sum over what lies behind are gathered from the back.
    let mut behind = end * d_end;
    let mut transmittance = end;
    for i in (0..weights.len()).rev() {
        d_sigma[i] = dt[i] * (transmittance * d_weights[i] - behind);
        behind += weights[i] * d_weights[i];
        transmittance += weights[i];
    }
}

/// The distortion loss of Barron et al. 2022 (equation 15), which draws a ray's weights together:
/// sum_ij w_i w_j |s_i - s_j| + sum_i w_i^2 ds_i / 3. Adds `scale` times its gradient to
/// `d_weights`, returns the loss. `s` ascends.
pub fn distortion(
    s: &[f32],
    ds: &[f32],
    weights: &[f32],
    scale: f32,
    d_weights: &mut [f32],
) -> f32 {
    let total: f32 = weights.iter().sum();
    let moment: f32 = weights.iter().zip(s).map(|(w, s)| w * s).sum();
    let mut before = 0.0;
    let mut moment_before = 0.0;
    let mut loss = 0.0;
    for i in 0..weights.len() {
        let w = weights[i];
        // |s_i - s_j| is s_i - s_j for what is before i, s_j - s_i for what is behind: running sums
        // make the double sum linear.
        let behind = total - before - w;
        let moment_behind = moment - moment_before - w * s[i];
        let distance = s[i] * (before - behind) - (moment_before - moment_behind);
        loss += w * distance + w * w * ds[i] / 3.0;
        d_weights[i] += scale * 2.0 * (distance + w * ds[i] / 3.0);
        before += w;
        moment_before += w * s[i];
    }
    loss
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn samples() -> impl Strategy<Value = Vec<(f32, f32, f32)>> {
        prop::collection::vec((0.0..8.0f32, 0.01..0.3f32, -1.0..1.0f32), 1..24)
    }

    fn unzip(samples: &[(f32, f32, f32)]) -> [Vec<f32>; 3] {
        [
            samples.iter().map(|s| s.0).collect(),
            samples.iter().map(|s| s.1).collect(),
            samples.iter().map(|s| s.2).collect(),
        ]
    }

    /// sum_i w_i g_i + T_end g_end by the defining products, in f64.
    fn brute_force(sigma: &[f32], dt: &[f32], g: &[f32], g_end: f32) -> f64 {
        let alpha: Vec<f64> = sigma
            .iter()
            .zip(dt)
            .map(|(s, d)| 1.0 - (-f64::from(*s) * f64::from(*d)).exp())
            .collect();
        let through = |i: usize| alpha[..i].iter().map(|a| 1.0 - a).product::<f64>();
        let seen: f64 = (0..alpha.len())
            .map(|i| through(i) * alpha[i] * f64::from(g[i]))
            .sum();
        seen + through(alpha.len()) * f64::from(g_end)
    }

    proptest! {
        #[test]
        fn weights_match_the_defining_products(samples in samples(), g_end in -1.0..1.0f32) {
            let [sigma, dt, g] = unzip(&samples);
            let mut w = vec![0.0; sigma.len()];
            let end = weights(&sigma, &dt, &mut w);
            let got: f32 = w.iter().zip(&g).map(|(w, g)| w * g).sum::<f32>() + end * g_end;
            prop_assert!((f64::from(got) - brute_force(&sigma, &dt, &g, g_end)).abs() < 1e-5);
            prop_assert!((w.iter().sum::<f32>() + end - 1.0).abs() < 1e-5, "weights and T_end share out 1");
        }

        #[test]
        fn the_gradient_to_sigma_matches_finite_differences(samples in samples(), g_end in -1.0..1.0f32) {
            let [sigma, dt, g] = unzip(&samples);
            let mut w = vec![0.0; sigma.len()];
            let mut d_sigma = vec![0.0; sigma.len()];
            let end = weights(&sigma, &dt, &mut w);
            weights_backward(&dt, &w, end, &g, g_end, &mut d_sigma);
            for i in 0..sigma.len() {
                let shifted = |h: f32| {
                    let mut moved = sigma.clone();
                    moved[i] += h;
                    brute_force(&moved, &dt, &g, g_end)
                };
                let numeric = (shifted(1e-2) - shifted(-1e-2)) / 2e-2;
                prop_assert!((f64::from(d_sigma[i]) - numeric).abs() < 1e-4, "{} {numeric}", d_sigma[i]);
            }
        }

        #[test]
        fn distortion_and_its_gradient_match_the_double_sum(samples in samples()) {
            let [w, ds, _] = unzip(&samples);
            let w: Vec<f32> = w.iter().map(|w| w / 8.0).collect();
            let s: Vec<f32> = ds.iter().scan(0.0, |end, d| { *end += d; Some(*end) }).collect();
            let double_sum = |w: &[f32]| {
                let n = w.len();
                let pairs: f64 = (0..n * n).map(|k| f64::from(w[k / n] * w[k % n] * (s[k / n] - s[k % n]).abs())).sum();
                pairs + w.iter().zip(&ds).map(|(w, d)| f64::from(w * w * d) / 3.0).sum::<f64>()
            };
            let mut d_w = vec![0.0; w.len()];
            let loss = distortion(&s, &ds, &w, 1.0, &mut d_w);
            prop_assert!((f64::from(loss) - double_sum(&w)).abs() < 1e-4 * (1.0 + f64::from(loss)));
            for i in 0..w.len() {
                let shifted = |h: f32| {
                    let mut moved = w.clone();
                    moved[i] += h;
                    double_sum(&moved)
                };
                let numeric = (shifted(1e-2) - shifted(-1e-2)) / 2e-2;
                prop_assert!((f64::from(d_w[i]) - numeric).abs() < 2e-3 * (1.0 + numeric.abs()), "{} {numeric}", d_w[i]);
            }
        }
    }

    #[test]
    fn a_wall_hides_what_is_behind_it() {
        assert_eq!(visible([0.1, 20.0, 0.1, 0.1].into_iter(), &mut 0.0), 2);
        assert_eq!(
            visible([5.0; 4].into_iter(), &mut 0.0),
            2,
            "exp(-10) is below the cut, exp(-5) is not"
        );
        let mut optical_depth = 0.0;
        assert_eq!(visible([0.1; 4].into_iter(), &mut optical_depth), 4);
        assert_eq!(
            visible([9.0; 4].into_iter(), &mut optical_depth),
            1,
            "what came before counts"
        );
    }
}
