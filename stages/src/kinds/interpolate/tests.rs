//! Alpha by a network, and where it stays as it is.

use super::*;

/// How much of each pixel of a picture of `side` pixels a disc covers, [1, 1, side, side].
fn disc(side: usize) -> Array {
    let covered = |i: usize| {
        let points = (0..64).filter(|k| {
            let x = (i % side) as f64 + (k % 8) as f64 / 8.0 + 1.0 / 16.0;
            let y = (i / side) as f64 + (k / 8) as f64 / 8.0 + 1.0 / 16.0;
            (x / side as f64 - 0.5).hypot(y / side as f64 - 0.5) < 0.35
        });
        points.count() as f32 / 64.0
    };
    Device::cpu().array(&[1, 1, side, side], (0..side * side).map(covered).collect())
}

fn learned() -> Interpolate {
    Interpolate {
        filter: Kernel::Learned(Learned::default()),
        back_projection: 3,
        ..Interpolate::default()
    }
}

fn network(stage: &Interpolate) -> Option<Upsampler> {
    stage
        .learned()
        .map(|learned| learned.load(&Device::cpu()).unwrap())
}

#[test]
fn an_outline_is_nearer_the_truth_by_a_network_than_by_bicubic() {
    let stage = learned();
    let small = disc(24);
    let truth = disc(96).to_vec();
    let error = |network: Option<&Upsampler>| {
        let large = stage.alpha(&small, [96, 96], network).to_vec();
        large
            .iter()
            .zip(&truth)
            .map(|(a, b)| (a - b).powi(2))
            .sum::<f32>()
    };
    let network = network(&stage);
    assert!(error(network.as_ref()) < 0.7 * error(None));
}

#[test]
fn what_is_opaque_all_over_stays_so() {
    let stage = learned();
    let opaque = Device::cpu().array(&[1, 1, 8, 8], vec![1.0; 64]);
    let large = stage.alpha(&opaque, [32, 32], network(&stage).as_ref());
    assert!(large.to_vec().iter().all(|&alpha| alpha == 1.0));
}
