//! The gradients of a bundle of rays against finite differences, and what its fog and its cut do.

use super::*;
use crate::config::FieldConfig;
use crate::kernels::hash::encode_backward;
use crate::ray_termination::{MIN_WEIGHT, RayTermination};
use compute::rng::Rng;
use half::f16;

/// Gradients of a loss to everything a field learns.
struct Gradient {
    table: Vec<[f32; FEATURES]>,
    weights: Vec<f32>,
}

/// A small field of strong features, so that every path carries a gradient that stands out from
/// rounding.
fn field() -> Field {
    let config = FieldConfig {
        levels: 4,
        log2_table: 9,
        base_resolution: 4,
        finest_resolution: 24,
        occupancy_resolution: 8,
        march_steps: 24,
        march_cone: Some(0.02),
    };
    let mut field = Field::new(&config, [[0.0; 3], [2.0, 1.0, 1.5]], 11);
    let rng = Rng::new(11, "block test");
    field
        .table
        .iter_mut()
        .enumerate()
        .for_each(|(i, entry)| *entry = [0, 1].map(|f| f16::from_f32(rng.normal(f, i as u64))));
    field.network.weights.iter_mut().for_each(|w| *w *= 2.5);
    field
}

/// Rays through the box, with the gradients that a loss would send back: a linear loss, different
/// for each ray.
fn rays() -> (Vec<Segment>, Vec<f32>, Vec<RayOutputGradient>) {
    let rng = Rng::new(12, "block test");
    let segment = |i: u64| {
        let direction = [0.3 * rng.normal(0, i), 0.3 * rng.normal(1, i), 1.0];
        let length = direction.iter().map(|x| x * x).sum::<f32>().sqrt();
        let origin = [0.5, 0.25, -0.5];
        let direction = direction.map(|x| x / length);
        Segment {
            origin,
            direction,
            range: [0.5, 1.3],
            view: direction,
            depth: [0.0, 1.0, 0.0],
        }
    };
    let gradient = |i: u64| RayOutputGradient {
        rgb: [2, 3, 4].map(|c| rng.normal(c, i)),
        transmittance: rng.normal(5, i),
    };
    (
        (0..12).map(segment).collect(),
        (0..12).map(|i| rng.uniform(6, i)).collect(),
        (0..12).map(gradient).collect(),
    )
}

/// The visible samples of [`rays`], their features and their rows among these.
fn visible_samples(field: &Field, least: f32) -> (Samples, Features, RayTermination) {
    let mut samples = Samples::default();
    let mut features = Features::default();
    let mut termination = RayTermination::default();
    let (segments, jitter, _) = rays();
    segments
        .into_iter()
        .zip(jitter)
        .for_each(|(segment, jitter)| samples.march(field, segment, jitter));
    termination.run(
        field,
        &mut samples,
        &mut features,
        &mut Activations::default(),
        least,
    );
    (samples, features, termination)
}

const REGULARIZER: Regularizer = Regularizer {
    distortion: 0.7,
    fog: 0.0,
    fog_range: 0.0,
};

fn loss_and_gradient(field: &Field, regularizer: Regularizer) -> (f64, Gradient) {
    let (samples, features, termination) = visible_samples(field, 0.0);
    let d_outputs = rays().2;
    let mut renderer = VolumeRenderer::default();
    let rays = RayBundle {
        samples: &samples,
        range: 0..d_outputs.len(),
        features: &features,
        rows: &termination.rows,
    };
    let linear = |(seen, d): (&RayOutput, &RayOutputGradient)| {
        let colors = seen
            .rgb
            .iter()
            .zip(d.rgb)
            .map(|(c, d)| f64::from(c * d))
            .sum::<f64>();
        colors + f64::from(seen.transmittance * d.transmittance)
    };
    let seen: f64 = renderer
        .forward(field, &rays)
        .iter()
        .zip(&d_outputs)
        .map(linear)
        .sum();
    let mut passed = FieldGradient::default();
    passed.clear(field);
    let transposed = field.network.transposed();
    let distortion = renderer.backward(
        field,
        &transposed,
        &rays,
        &d_outputs,
        regularizer,
        &mut passed,
    );
    passed.pad();
    let mut table = vec![[0.0; 2]; field.table.len()];
    for (level, d) in field.levels.iter().zip(&passed.levels) {
        let table = &mut table[level.offset..level.offset + level.entries];
        encode_backward(level, passed.positions.since(0), d, table);
    }
    (
        seen + f64::from(regularizer.distortion * distortion),
        Gradient {
            table,
            weights: passed.weights,
        },
    )
}

/// Compares gradients with central differences of the loss. A step that carries a unit across the
/// kink of its ReLU gives a wrong difference; few do.
fn compare(pairs: impl Iterator<Item = (f32, f64)>) {
    let mut large = 0;
    let mut wrong = 0;
    let mut count = 0;
    for (analytic, numeric) in pairs {
        count += 1;
        large += usize::from(numeric.abs() > 0.002);
        wrong += usize::from((f64::from(analytic) - numeric).abs() > 0.03 * numeric.abs() + 3e-4);
    }
    assert!(
        large * 12 > count,
        "only {large} of {count} gradients are large enough to tell"
    );
    assert!(wrong * 12 < count, "{wrong} of {count} gradients are wrong");
}

#[test]
fn gradients_of_the_whole_renderer_match_finite_differences() {
    const STEP: f32 = 2e-3;
    let field = field();
    let (_, gradient) = loss_and_gradient(&field, REGULARIZER);
    let difference = |change: &dyn Fn(&mut Field, f32)| {
        let at = |shift| {
            let mut moved = field.clone();
            change(&mut moved, shift);
            loss_and_gradient(&moved, REGULARIZER).0
        };
        (at(STEP) - at(-STEP)) / f64::from(2.0 * STEP)
    };
    let touched: Vec<usize> = (0..field.table.len())
        .filter(|&i| gradient.table[i] != [0.0; 2])
        .collect();
    assert!(touched.len() > 200, "{} entries are touched", touched.len());
    compare(touched.iter().step_by(7).map(|&i| {
        (
            gradient.table[i][1],
            difference(&|f, h| f.table[i][1] = f16::from_f32(f.table[i][1].to_f32() + h)),
        )
    }));
    for (l, layer) in field.network.layers.iter().enumerate() {
        let used = (0..layer.used[0])
            .flat_map(|row| (0..layer.used[1]).map(move |column| row * layer.outputs + column));
        let mut flags = Field { ..field.clone() };
        flags.network.weights.fill(0.0);
        let checked: Vec<usize> = used.step_by(17).collect();
        compare(checked.into_iter().map(|at| {
            flags.network.matrix_mut(l)[at] = 1.0;
            let place = flags
                .network
                .weights
                .iter()
                .position(|&w| w == 1.0)
                .unwrap();
            flags.network.matrix_mut(l)[at] = 0.0;
            (
                gradient.weights[place],
                difference(&|f, h| f.network.weights[place] += h),
            )
        }));
    }
}

#[test]
fn fog_is_pulled_down_near_the_camera_only() {
    let field = field();
    let pull = |fog_range| {
        let none = loss_and_gradient(&field, Regularizer::default()).1;
        let fog = loss_and_gradient(
            &field,
            Regularizer {
                fog: 1.0,
                fog_range,
                ..Regularizer::default()
            },
        )
        .1;
        none.table
            .iter()
            .zip(&fog.table)
            .filter(|(a, b)| a != b)
            .count()
    };
    assert_eq!(pull(0.0), 0);
    assert!(0 < pull(0.2) && pull(0.2) < pull(1.0));
}

#[test]
fn what_is_faint_is_left_out_and_hardly_missed() {
    let mut field = field();
    // A thinner haze, which no ray ends in.
    field
        .network
        .matrix_mut(1)
        .iter_mut()
        .step_by(GEOMETRY)
        .for_each(|w| *w *= 4.0);
    let (all, features, whole) = visible_samples(&field, 0.0);
    let (kept, _, thinned) = visible_samples(&field, MIN_WEIGHT);
    assert!(!kept.t.is_empty() && kept.t.len() < all.t.len());
    let see = |samples: &Samples, termination: &RayTermination| {
        let rays = RayBundle {
            samples,
            range: 0..samples.rays.len(),
            features: &features,
            rows: &termination.rows,
        };
        let mut renderer = VolumeRenderer::default();
        let seen = renderer
            .forward_from(&field, &rays, &termination.geometry)
            .to_vec();
        assert_eq!(seen, renderer.forward(&field, &rays), "the same densities");
        seen
    };
    let most = all.rays.iter().map(|ray| ray.len()).max().unwrap() as f32 * MIN_WEIGHT;
    for (thin, whole) in see(&kept, &thinned).iter().zip(see(&all, &whole)) {
        assert!((thin.transmittance - whole.transmittance).abs() <= most);
    }
}

#[test]
fn what_a_wall_hides_is_cut_off() {
    let mut field = field();
    let see = |field: &Field| {
        let (samples, features, termination) = visible_samples(field, 0.0);
        let rays = RayBundle {
            samples: &samples,
            range: 0..samples.rays.len(),
            features: &features,
            rows: &termination.rows,
        };
        (
            VolumeRenderer::default().forward(field, &rays).to_vec(),
            samples.t.len(),
            termination.queried,
        )
    };
    let (seen, kept, before) = see(&field);
    assert!(kept <= before);
    // A hundredfold density network makes the haze a wall.
    field
        .network
        .matrix_mut(1)
        .iter_mut()
        .for_each(|w| *w = w.abs() * 100.0);
    let (walled, kept, queried) = see(&field);
    assert!(kept < before / 2, "{kept} of {before}");
    assert!(
        queried < before,
        "a ray that has ended is not queried along any further"
    );
    assert!(
        walled.iter().zip(&seen).all(
            |(wall, haze)| wall.transmittance < 1e-3 && wall.transmittance < haze.transmittance
        )
    );
}
