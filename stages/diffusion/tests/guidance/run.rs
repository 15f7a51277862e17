//! How a run goes: its order, its determinism, what it leaves alone and what it refuses.

use std::ops::ControlFlow;

use compute::Device;
use diffusion::guidance::{Guidance, Rsd, Vsd};
use diffusion::optimize::{Optimization, Options, StepLog, ViewLatents, optimize};

use crate::gaussian::{Gaussian, view};

/// Three views of different sizes.
pub fn views() -> Vec<ViewLatents> {
    vec![view(0, [8, 6]), view(1, [7, 9]), view(2, [12, 12])]
}

/// VSD with windows of 6x6, two views a step.
pub fn options() -> Options {
    let vsd = Vsd {
        warm_up: 2,
        lora_every: 3,
        ..Vsd::default()
    };
    Options {
        guidance: Guidance::Vsd(vsd),
        steps: 8,
        batch: 2,
        crop: 6,
        ..Options::default()
    }
}

pub fn prior() -> Gaussian {
    Gaussian::new(0.3, 0.1, 2 * 6 * 6)
}

/// Each view's residual after a whole run.
pub fn residuals(seed: u64, options: &Options) -> Vec<Vec<f32>> {
    let optimized = optimize(&prior(), &views(), options, seed, &mut |_| {
        ControlFlow::Continue(())
    })
    .unwrap();
    optimized
        .residuals
        .iter()
        .map(|residual| residual.to_vec())
        .collect()
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_one_does_not() {
    assert_eq!(residuals(1, &options()), residuals(1, &options()));
    assert_ne!(residuals(1, &options()), residuals(2, &options()));
}

#[test]
fn pixels_that_no_window_covered_are_left_alone() {
    let prior = prior();
    let views = views();
    let options = Options {
        steps: 3,
        ..options()
    };
    let mut optimization = Optimization::new(&prior, &views, &options, 1).unwrap();
    while !optimization.is_done() {
        optimization.step().unwrap();
    }
    let mut seen = 0;
    for residual in &optimization.state().residuals {
        for (i, value) in residual.values.iter().enumerate() {
            let visited = residual.visits[i % residual.visits.len()] > 0;
            assert_eq!(visited, *value != 0.0);
            seen += usize::from(visited);
        }
    }
    assert!(seen > 0);
}

#[test]
fn all_views_take_their_turns() {
    let prior = Gaussian::new(0.3, 0.1, 2 * 7 * 6);
    let views = views();
    let options = Options {
        steps: 3,
        crop: 100,
        batch: 1,
        ..options()
    };
    let mut optimization = Optimization::new(&prior, &views, &options, 1).unwrap();
    while !optimization.is_done() {
        optimization.step().unwrap();
    }
    let visits = |view: usize| {
        optimization.state().residuals[view]
            .visits
            .iter()
            .sum::<u32>()
    };
    assert_eq!([visits(0), visits(1), visits(2)], [42, 42, 42]);
}

#[test]
fn the_lora_warms_up_and_then_learns_on_every_third_step() {
    let log = optimize(&prior(), &views(), &options(), 1, &mut |_| {
        ControlFlow::Continue(())
    })
    .unwrap()
    .log;
    let line = |log: &StepLog| match (log.guidance.is_some(), log.lora_loss.is_some()) {
        (true, true) => "both",
        (true, false) => "guide",
        (false, true) => "learn",
        (false, false) => "nothing",
    };
    let lines: Vec<_> = log.iter().map(line).collect();
    assert_eq!(
        lines,
        [
            "learn", "learn", "both", "guide", "guide", "both", "guide", "guide", "both", "guide"
        ]
    );
}

#[test]
fn a_caller_can_stop_a_run() {
    let mut left = 4;
    let optimized = optimize(&prior(), &views(), &options(), 1, &mut |_| {
        left -= 1;
        if left == 0 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    assert_eq!(optimized.unwrap().log.len(), 4);
}

#[test]
fn the_bad_prompt_is_asked_only_where_guidance_needs_it() {
    let asked = |guidance_scale| {
        let prior = prior();
        let options = Options {
            guidance_scale,
            ..options()
        };
        optimize(&prior, &views(), &options, 1, &mut |_| {
            ControlFlow::Continue(())
        })
        .unwrap();
        prior.asked_bad.get()
    };
    assert_eq!((asked(1.0), asked(2.0)), (0, 8));
}

#[test]
fn masked_latents_stay_as_they_are_encoded() {
    let mut views = views();
    views[1].mask = Some((0..63).map(|pixel| pixel % 9 > 3).collect());
    let on = &mut |_: &StepLog| ControlFlow::Continue(());
    let optimized = optimize(&prior(), &views, &options(), 1, on).unwrap();
    let residual = optimized.residuals[1].to_vec();
    let moved = |masked: bool| {
        let elements = residual.iter().enumerate();
        elements
            .filter(|(i, value)| (i % 9 <= 3) == masked && **value != 0.0)
            .count()
    };
    assert_eq!(moved(true), 0);
    assert!(moved(false) > 0);
    views[1].mask = Some(vec![true; 7]);
    let refused = Optimization::new(&prior(), &views, &options(), 1)
        .err()
        .unwrap();
    assert_eq!(
        refused.to_string(),
        "view `view_001` has a mask of 7 values; its latent asks for 63"
    );
}

#[test]
fn views_that_do_not_fit_are_refused_by_name() {
    let device = Device::cpu();
    let refusal = |views: &[ViewLatents]| {
        Optimization::new(&prior(), views, &options(), 1)
            .err()
            .unwrap()
            .to_string()
    };
    let narrow = ViewLatents {
        low: device.zeros(&[3, 8, 5]),
        ..view(1, [8, 6])
    };
    let other = ViewLatents {
        latent: device.zeros(&[4, 8, 6]),
        ..view(1, [8, 6])
    };
    assert_eq!(refusal(&[]), "there are no views");
    assert_eq!(
        refusal(&[view(0, [8, 6]), narrow]),
        "view `view_001` has a low-resolution image of shape [3, 8, 5]; its latent asks for [3, 8, 6]"
    );
    assert_eq!(
        refusal(&[view(0, [8, 6]), other]),
        "view `view_001` has a latent of shape [4, 8, 6]; the first view's is [2, 8, 6]"
    );
    assert_eq!(
        refusal(&[view(0, [8, 0])]),
        "view `view_000` has an empty latent, of shape [2, 8, 0]"
    );
}

#[test]
fn latents_that_diverge_stop_the_run() {
    let rsd = Guidance::Rsd(Rsd {
        rate: 1e30,
        ..Rsd::default()
    });
    let options = Options {
        guidance: rsd,
        optimizer: diffusion::optimize::Optimizer::Sgd,
        ..options()
    };
    let stopped = optimize(&prior(), &views(), &options, 1, &mut |_| {
        ControlFlow::Continue(())
    })
    .err()
    .unwrap();
    assert!(
        stopped
            .to_string()
            .starts_with("the latents diverged in step "),
        "{stopped}"
    );
}
