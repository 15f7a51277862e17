//! The gradients of both networks against finite differences.

use super::*;

const ROWS: usize = 16;

fn random(len: usize, step: u64) -> Vec<f32> {
    let rng = Rng::new(9, "network test");
    (0..len as u64).map(|i| rng.normal(step, i)).collect()
}

/// A linear functional of both networks' outputs.
fn loss(network: &Network, a: &mut Activations, c: &[f32], g: &[f32]) -> f64 {
    network.density(a);
    network.color(a);
    let dot = |x: &[f32], y: &[f32]| {
        x.iter()
            .zip(y)
            .map(|(x, y)| f64::from(*x) * f64::from(*y))
            .sum::<f64>()
    };
    dot(&a.color, c) + dot(&a.geometry, g)
}

#[test]
fn gradients_match_finite_differences() {
    let network = Network::new(32, 32, 5);
    let mut c = random(ROWS * COLOR_OUTPUT, 0);
    let g = random(ROWS * GEOMETRY, 1);
    c.chunks_exact_mut(COLOR_OUTPUT)
        .for_each(|row| row[3..].fill(0.0)); // What is padding has no gradient.
    let encoding = random(ROWS * 32, 2);
    let fresh = || {
        let mut a = Activations {
            encoding: encoding.clone(),
            ..Default::default()
        };
        a.set_directions(
            [
                ([0.6, 0.0, 0.8], 0..5),
                ([0.0, 1.0, 0.0], 5..6),
                ([-0.48, 0.6, 0.64], 6..ROWS),
            ]
            .into_iter(),
        );
        a
    };
    let mut a = fresh();
    loss(&network, &mut a, &c, &g);
    let mut d_weights = vec![0.0; network.weights.len()];
    let turned = network.transposed();
    a.color.clone_from(&c);
    network.color_backward(&turned, &mut a, &mut d_weights);
    a.geometry.iter_mut().zip(&g).for_each(|(d, g)| *d += g);
    network.density_backward(&turned, &mut a, &mut d_weights);

    // A difference that carries a unit across the kink of its ReLU is wrong; few do.
    let mut checked = 0;
    let mut wrong = 0;
    let mut check = |analytic: f32, difference: f64| {
        let numeric = difference / 1e-3;
        checked += 1;
        wrong += usize::from((numeric - f64::from(analytic)).abs() > 0.02 * (1.0 + numeric.abs()));
    };
    for at in (0..network.weights.len()).step_by(97) {
        let at_shift = |shift| {
            let mut moved = network.clone();
            moved.weights[at] += shift;
            loss(&moved, &mut fresh(), &c, &g)
        };
        check(d_weights[at], at_shift(5e-4) - at_shift(-5e-4));
    }
    for at in (0..ROWS * 32).step_by(31) {
        let at_shift = |shift| {
            let mut moved = fresh();
            moved.encoding[at] += shift;
            loss(&network, &mut moved, &c, &g)
        };
        check(a.encoding[at], at_shift(5e-4) - at_shift(-5e-4));
    }
    assert!(
        wrong * 10 < checked,
        "{wrong} of {checked} gradients are wrong"
    );
}
