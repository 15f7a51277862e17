//! Identities that hold between the rules, whatever the network says.

use compute::elementwise::{scale, sub};
use compute::{Array, Device, Rng};
use diffusion::guidance::{
    Loss, Prediction, Prompt, Rsd, Rule, Sds, Vsd, Weighting, classifier_free, kappa,
};
use diffusion::schedule::Schedule;

use crate::gaussian::schedule;

/// A latent, its noise and any network's velocities, at timesteps 980 and 500.
struct Draw {
    schedule: Schedule,
    latent: Array,
    noise: Array,
    noisy: Array,
    positive: Array,
    negative: Array,
}

const T: [u32; 2] = [980, 500];

fn draw() -> Draw {
    let schedule = schedule();
    let rng = Rng::new(7, "rules");
    let normals = |step| rng.normals(step, &[2, 4, 5, 3], &Device::cpu());
    let noisy = schedule.add_noise(&normals(0), &normals(1), &T);
    Draw {
        schedule,
        latent: normals(0),
        noise: normals(1),
        noisy,
        positive: normals(2),
        negative: normals(3),
    }
}

impl Draw {
    fn estimate<'a>(
        &'a self,
        velocity: &'a Array,
        lora_velocity: Option<&'a Array>,
    ) -> Prediction<'a> {
        Prediction {
            latent: &self.latent,
            noise: &self.noise,
            noisy: &self.noisy,
            velocity,
            lora_velocity,
            t: &T,
        }
    }

    fn rsd(&self, weight: Weighting) -> Array {
        Rsd {
            weight,
            ..Rsd::default()
        }
        .direction(&self.schedule, &self.estimate(&self.positive, None))
    }

    fn sds(&self) -> Array {
        Sds::default().direction(&self.schedule, &self.estimate(&self.positive, None))
    }
}

/// The two samples of a batch.
fn halves(x: &Array) -> [Vec<f32>; 2] {
    let mut first = x.to_vec();
    let second = first.split_off(first.len() / 2);
    [first, second]
}

#[track_caller]
fn assert_close(actual: &[f32], expected: impl Iterator<Item = f64>, tolerance: f64) {
    for (&actual, expected) in actual.iter().zip(expected) {
        assert!(
            (f64::from(actual) - expected).abs() <= tolerance,
            "{actual} is not {expected}"
        );
    }
}

#[test]
fn the_renoised_difference_is_kappa_times_the_distance_to_the_estimate() {
    // (a) z_t' - zhat_t' = kappa (z' - x0_hat), with zhat_t' = (s_t' / s_t) z_t + kappa x0_hat and
    // one noise for both.
    let d = draw();
    let renoised = d.schedule.add_noise(&d.latent, &d.noise, &[979, 499]);
    let clean = d.schedule.clean(&d.noisy, &d.positive, &T);
    let to_clean = halves(&d.rsd(Weighting::One));
    for (i, t) in T.into_iter().enumerate() {
        let kappa = kappa(&d.schedule, t, 1);
        let ratio = d.schedule.s(t - 1) / d.schedule.s(t);
        let [renoised, noisy, clean] = [&renoised, &d.noisy, &clean].map(|x| halves(x)[i].clone());
        let difference = (0..clean.len())
            .map(|e| {
                f64::from(renoised[e]) - ratio * f64::from(noisy[e]) - kappa * f64::from(clean[e])
            })
            .collect::<Vec<_>>();
        let expected: Vec<f64> = to_clean[i].iter().map(|&g| kappa * f64::from(g)).collect();
        assert_close(
            &difference.iter().map(|&x| x as f32).collect::<Vec<_>>(),
            expected.into_iter(),
            1e-6,
        );
    }
}

#[test]
fn the_noise_surplus_is_the_distance_to_the_estimate_weighted() {
    // (b) eps_hat - eps = (a / s) (z' - x0_hat); times (1 - alpha_bar) = s^2 for SDS.
    let d = draw();
    for ((sds, rsd), t) in halves(&d.sds())
        .iter()
        .zip(halves(&d.rsd(Weighting::One)))
        .zip(T)
    {
        assert_close(
            sds,
            rsd.iter()
                .map(|&g| d.schedule.s(t) * d.schedule.a(t) * f64::from(g)),
            1e-6,
        );
    }
}

#[test]
fn under_l1_rsd_and_sds_are_the_same_update() {
    // (c) All weights are positive, and a sign knows no weight.
    let d = draw();
    let sign = |direction: &Array| Loss::L1.gradient(direction).to_vec();
    let rsd = sign(&d.rsd(Weighting::One));
    assert_eq!(rsd, sign(&d.sds()));
    assert_eq!(rsd, sign(&d.rsd(Weighting::Renoised { spacing: 1 })));
    assert_ne!(rsd, sign(&scale(&d.sds(), -1.0)));
}

#[test]
fn kappa_is_small_for_neighbouring_timesteps_and_one_for_all_the_way() {
    // (d)
    let schedule = schedule();
    assert!((kappa(&schedule, 980, 1) - 3.2059e-4).abs() < 1e-8);
    assert!((kappa(&schedule, 500, 1) - 2.4835e-3).abs() < 1e-7);
    assert_eq!(kappa(&schedule, 10, 11), 1.0);
}

#[test]
fn the_renoised_weight_is_what_squared_distances_give() {
    let d = draw();
    let one = halves(&d.rsd(Weighting::One));
    let renoised = halves(&d.rsd(Weighting::Renoised { spacing: 1 }));
    for ((one, renoised), t) in one.iter().zip(&renoised).zip(T) {
        let weight = d.schedule.a(t - 1) * kappa(&d.schedule, t, 1);
        assert_close(renoised, one.iter().map(|&g| weight * f64::from(g)), 1e-8);
    }
}

#[test]
fn vsd_with_a_lora_that_changes_nothing_is_the_pure_difference_of_prompts() {
    // (e) (cfg - 1) (v_good - v_bad) a (1 - alpha_bar).
    let d = draw();
    let guided = classifier_free(7.5, |prompts| {
        assert_eq!(prompts, [Prompt::Positive, Prompt::Negative]);
        vec![d.positive.clone(), d.negative.clone()]
    });
    let rule = Vsd {
        anchor: 0.0,
        ..Vsd::default()
    };
    let direction = rule.direction(&d.schedule, &d.estimate(&guided, Some(&d.positive)));
    for ((direction, difference), t) in halves(&direction)
        .iter()
        .zip(halves(&sub(&d.positive, &d.negative)))
        .zip(T)
    {
        let weight = 6.5 * d.schedule.a(t) * (1.0 - d.schedule.alpha_bar(t));
        assert_close(
            direction,
            difference.iter().map(|&x| weight * f64::from(x)),
            1e-5,
        );
    }
}

#[test]
fn the_anchor_adds_a_share_of_rsd() {
    let d = draw();
    let estimate = d.estimate(&d.positive, Some(&d.negative));
    let vsd = |anchor| {
        Vsd {
            anchor,
            ..Vsd::default()
        }
        .direction(&d.schedule, &estimate)
    };
    let added = sub(&vsd(0.25), &vsd(0.0));
    assert_close(
        &added.to_vec(),
        d.rsd(Weighting::One)
            .to_vec()
            .iter()
            .map(|&g| 0.25 * f64::from(g)),
        1e-5,
    );
}

#[test]
fn at_scale_one_the_bad_prompt_is_not_asked() {
    let d = draw();
    let guided = classifier_free(1.0, |prompts| {
        assert_eq!(prompts, [Prompt::Positive]);
        vec![d.positive.clone()]
    });
    assert_eq!(guided.to_vec(), d.positive.to_vec());
}
