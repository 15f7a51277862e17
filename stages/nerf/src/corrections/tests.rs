//! The torques and forces on a camera against finite differences of what its rays see.

use super::*;
use crate::config::FieldConfig;
use crate::features::Features;
use crate::march::Segment;
use crate::poses::PoseOptions;
use crate::space::{Space, SpaceKind};
use crate::volume_rendering::{
    RayBundle, RayOutput, RayOutputGradient, Regularizer, VolumeRenderer,
};
use compute::rng::Rng;
use formats::{Camera, Pixels};
use glam::{DMat3, DMat4, DQuat, DVec3};
use half::f16;

/// Rays through the field.
const RAYS: u64 = 24;
/// Samples on each ray.
const PLACES: u64 = 12;

fn camera() -> Camera {
    let pose = Camera::look_at(DVec3::new(0.6, 0.4, 2.9), DVec3::new(0.9, 0.5, 0.7));
    Camera::centered((24, 24), 90.0, pose, [1.0, 3.0])
}

/// A field of strong features, so that every gradient stands out from rounding.
fn field(kind: SpaceKind) -> Field {
    let config = FieldConfig {
        levels: 3,
        log2_table: 9,
        base_resolution: 3,
        finest_resolution: 8,
        occupancy_resolution: 8,
        march_steps: 24,
        march_cone: Some(0.02),
    };
    let space = Space::of(kind, [[0.0; 3], [2.0, 1.0, 1.5]], &[&camera()]).unwrap();
    let mut field = Field::in_space(&config, space, 11);
    let rng = Rng::new(11, "corrections test");
    let entries = field.table.iter_mut().enumerate();
    entries.for_each(|(i, entry)| *entry = [0, 1].map(|f| f16::from_f32(rng.normal(f, i as u64))));
    field.network.weights.iter_mut().for_each(|w| *w *= 2.5);
    field
}

/// The camera turned about itself and shifted, with points that stay where they are before it.
fn samples(field: &Field, camera: &Camera) -> Samples {
    let rng = Rng::new(12, "corrections test");
    let mut samples = Samples::default();
    for ray in 0..RAYS {
        let [px, py] = [0, 1].map(|axis| 24.0 * f64::from(rng.uniform(axis, ray)));
        let first = samples.t.len();
        for place in 0..PLACES {
            let depth = 1.4 + 1.2 * (place as f64 + f64::from(rng.uniform(2, ray))) / PLACES as f64;
            let point = camera.unproject(px, py, depth).map(|x| x as f32);
            samples
                .positions
                .push(field.space.to_unit(point).map(|x| x.max(0.0)));
            samples.t.push(depth as f32);
            samples.dt.push(0.08);
        }
        samples.rays.push(first..samples.t.len());
        samples
            .segments
            .push(Segment::new(&field.space, camera, px, py));
    }
    samples
}

fn d_outputs() -> Vec<RayOutputGradient> {
    let rng = Rng::new(13, "corrections test");
    let gradient = |i: u64| RayOutputGradient {
        rgb: [2, 3, 4].map(|c| rng.normal(c, i)),
        transmittance: rng.normal(5, i),
    };
    (0..RAYS).map(gradient).collect()
}

/// A linear loss of what the rays see, and the gradients to samples and directions.
fn loss(field: &Field, samples: &Samples) -> (f64, FieldGradient) {
    let mut features = Features::default();
    let places = (0..samples.t.len()).map(|i| samples.positions.at(i));
    field.look_up(places, &mut features);
    let rows: Vec<u32> = (0..samples.t.len() as u32).collect();
    let d_outputs = d_outputs();
    let rays = RayBundle {
        samples,
        range: 0..RAYS as usize,
        features: &features,
        rows: &rows,
    };
    let mut renderer = VolumeRenderer::default();
    let linear = |(output, d): (&RayOutput, &RayOutputGradient)| {
        let colors: f64 = (0..3).map(|c| f64::from(output.rgb[c] * d.rgb[c])).sum();
        colors + f64::from(output.transmittance * d.transmittance)
    };
    let outputs = renderer.forward(field, &rays);
    let loss = outputs.iter().zip(&d_outputs).map(linear).sum();
    let mut gradient = FieldGradient {
        directions: Some(vec![]),
        ..FieldGradient::default()
    };
    gradient.clear(field);
    let none = Regularizer::default();
    renderer.backward(
        field,
        &field.network.transposed(),
        &rays,
        &d_outputs,
        none,
        &mut gradient,
    );
    gradient.pad();
    (loss, gradient)
}

fn moved(camera: &Camera, turn: DVec3, shift: DVec3) -> Camera {
    let rotation = DMat3::from_quat(DQuat::from_scaled_axis(turn));
    let mut camera_to_world = DMat4::from_mat3(rotation * DMat3::from_mat4(camera.camera_to_world));
    camera_to_world.w_axis = (camera.position() + shift).extend(1.0);
    Camera {
        camera_to_world,
        ..*camera
    }
}

#[test]
fn torques_and_forces_match_finite_differences_in_a_box_and_in_perspective() {
    for kind in [SpaceKind::Box, SpaceKind::Perspective] {
        let field = field(kind);
        let view = TrainView {
            camera: camera(),
            pixels: Pixels::opaque(vec![0.0; 3 * 24 * 24]).into(),
            mask: None,
            weight: 1.0,
            supersample: 1,
        };
        let pixel = |element: u64| Pixel {
            view: 0,
            x: 0,
            y: 0,
            element,
            background: [0.0; 3],
        };
        let pixels: Vec<Pixel> = (0..RAYS).map(pixel).collect();
        let at = samples(&field, &view.camera);
        let (_, gradient) = loss(&field, &at);
        let mut pulls = [[0.0; COUNT]];
        cameras_backward(&field, &[view], &pixels, &at, &gradient, &mut pulls);
        let size = pulls[0].iter().fold(0.0f32, |most, x| most.max(x.abs()));
        for i in 0..COUNT {
            let value = |step: f64| {
                let mut change = [0.0; COUNT];
                change[i] = step;
                let [a, b, c, d, e, f] = change;
                let camera = moved(&camera(), DVec3::new(a, b, c), DVec3::new(d, e, f));
                loss(&field, &samples(&field, &camera)).0
            };
            // Longer steps carry more units across the kinks of their ReLUs.
            let numeric = (value(2e-5) - value(-2e-5)) / 4e-5;
            let got = f64::from(pulls[0][i]);
            assert!(
                (got - numeric).abs() < 0.04 * f64::from(size),
                "{kind:?} {i}: {got} {numeric}"
            );
        }
    }
}

#[test]
fn nothing_is_learnt_unless_it_is_asked_for() {
    let options = TrainOptions {
        poses: Some(PoseOptions::default()),
        ..TrainOptions::default()
    };
    let corrections = Corrections::new(&options, &[]);
    assert!(corrections.exposure(0).is_none() && !corrections.move_cameras(10));
    assert!(corrections.move_cameras(PoseOptions::default().start));
    assert!(
        Corrections::new(&TrainOptions::default(), &[])
            .tensors()
            .is_empty()
    );
}
