//! (i) With the exact denoiser of N(mean, TAU^2), every rule has one fixed point: z' = mean.
//! Guidance from another mean at scale s moves it to negative + s (positive - negative), as x0_hat is linear in
//! the mean.

use diffusion::guidance::{Guidance, Rsd, Sds, Timesteps, Vsd, Weighting};
use diffusion::optimize::{Moments, Optimizer, Options, ViewLatents, optimize};

use crate::gaussian::{Gaussian, view};

const GOOD: f32 = 0.3;
const BAD: f32 = 0.1;

/// Where two views of 6x4 latents end, element by element.
fn end(guidance: Guidance, guidance_scale: f64, optimizer: Optimizer) -> Vec<f32> {
    let views = [view(0, [6, 4]), view(1, [6, 4])];
    let options = Options {
        guidance,
        guidance_scale,
        optimizer,
        steps: 2000,
        ..Options::default()
    };
    let prior = Gaussian::new(GOOD, BAD, views[0].latent.len());
    let optimized = optimize(&prior, &views, &options, 5, &mut |_| {
        std::ops::ControlFlow::Continue(())
    })
    .unwrap();
    let current = |(view, residual): (&ViewLatents, _)| {
        compute::elementwise::add(&view.latent, residual).to_vec()
    };
    views
        .iter()
        .zip(&optimized.residuals)
        .flat_map(current)
        .collect()
}

#[track_caller]
fn assert_ends_at(mean: f32, latents: &[f32]) {
    let average = latents.iter().sum::<f32>() / latents.len() as f32;
    let farthest = latents.iter().map(|z| (z - mean).abs()).fold(0.0, f32::max);
    assert!(
        (average - mean).abs() < 0.01,
        "the average is {average}, not {mean}"
    );
    assert!(
        farthest < 0.05,
        "an element lies {farthest} away from {mean}"
    );
}

fn adam(eps: f64) -> Optimizer {
    Optimizer::Adam(Moments {
        eps,
        ..Moments::default()
    })
}

fn vsd(anchor: f64) -> Guidance {
    let timesteps = Timesteps::Annealed { from: 0.7, to: 0.5 };
    Guidance::Vsd(Vsd {
        rate: 0.002,
        lora_rate: 5e-3,
        anchor,
        camera_drop: 0.0,
        timesteps,
        ..Vsd::default()
    })
}

#[test]
fn rsd_ends_at_the_mean() {
    assert_ends_at(
        0.3,
        &end(Guidance::Rsd(Rsd::default()), 1.0, Optimizer::default()),
    );
    assert_ends_at(
        0.3,
        &end(Guidance::Rsd(Rsd::default()), 1.0, Optimizer::Sgd),
    );
}

#[test]
fn rsd_ends_at_the_guided_mean() {
    assert_ends_at(
        0.5,
        &end(Guidance::Rsd(Rsd::default()), 2.0, Optimizer::default()),
    );
}

#[test]
fn rsd_in_the_renoised_weight_ends_at_the_mean() {
    let rsd = Rsd {
        rate: 0.002,
        weight: Weighting::Renoised { spacing: 1 },
        ..Rsd::default()
    };
    assert_ends_at(0.3, &end(Guidance::Rsd(rsd), 1.0, adam(1e-15)));
}

#[test]
fn sds_ends_at_the_guided_mean() {
    assert_ends_at(
        0.3,
        &end(Guidance::Sds(Sds::default()), 1.0, Optimizer::default()),
    );
    assert_ends_at(
        0.5,
        &end(Guidance::Sds(Sds::default()), 2.0, Optimizer::default()),
    );
}

#[test]
fn vsd_ends_at_the_guided_mean_once_the_lora_follows() {
    assert_ends_at(0.3, &end(vsd(0.0), 1.0, Optimizer::default()));
    assert_ends_at(0.5, &end(vsd(0.0), 2.0, Optimizer::default()));
}

#[test]
fn an_anchor_leaves_the_fixed_point_where_it_is() {
    assert_ends_at(0.5, &end(vsd(0.2), 2.0, Optimizer::default()));
}
