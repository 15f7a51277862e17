//! A run that goes on from its state: with the same bits, and only from a state of its own.

use diffusion::guidance::{Guidance, Rsd};
use diffusion::optimize::{Optimization, OptimizeError, Options};

use crate::run::{options, prior, residuals, views};

#[test]
fn a_run_goes_on_from_its_state_with_the_same_bits() {
    let prior = prior();
    let views = views();
    let options = options();
    let mut first = Optimization::new(&prior, &views, &options, 1).unwrap();
    for _ in 0..5 {
        first.step().unwrap();
    }
    let mut second = Optimization::new(&prior, &views, &options, 1)
        .unwrap()
        .resume(first.state().clone())
        .unwrap();
    while !second.is_done() {
        second.step().unwrap();
    }
    let resumed: Vec<_> = second
        .state()
        .residuals
        .iter()
        .map(|residual| residual.values.clone())
        .collect();
    assert_eq!(resumed, residuals(1, &options));
}

#[test]
fn a_state_of_other_views_or_another_rule_is_refused() {
    let prior = prior();
    let views = views();
    let options = options();
    let state = Optimization::new(&prior, &views, &options, 1)
        .unwrap()
        .state()
        .clone();
    let without_lora = Options {
        guidance: Guidance::Rsd(Rsd::default()),
        ..options.clone()
    };
    for (views, options) in [(&views[..2], &options), (&views[..], &without_lora)] {
        let resumed = Optimization::new(&prior, views, options, 1)
            .unwrap()
            .resume(state.clone());
        assert!(matches!(resumed.err(), Some(OptimizeError::OtherState)));
    }
}
