use super::*;
use crate::cloud::Splat;
use crate::harmonics::MOST;
use glam::{DMat4, Quat, Vec3};

/// A number of a splat.
type Number = fn(&mut Splat) -> &mut f32;
/// The derivative by it.
type Gradient = fn(&BySplat) -> f32;

const SIZE: (u32, u32) = (40, 24);

fn camera() -> Camera {
    Camera::centered(SIZE, 40.0, DMat4::IDENTITY, [0.5, 9.0])
}

/// Splats of all kinds in front of the camera, by numbers that look random.
fn cloud(count: u32) -> Cloud {
    let part =
        |i: u32, what: u32| ((i * 12.9898 as u32 + 7 * what + i * i * 31) % 97) as f32 / 97.0;
    let splat = |i: u32| {
        let at = |what| 2.0 * part(i, what) - 1.0;
        let mut harmonics = [[0.0; 3]; MOST];
        for (j, coefficient) in harmonics.iter_mut().enumerate() {
            *coefficient = [0, 1, 2].map(|c| 0.6 * at(20 + 3 * j as u32 + c));
        }
        Splat {
            position: Vec3::new(1.5 * at(0), at(1), -4.0 + at(2)),
            rotation: Quat::from_xyzw(at(3), at(4), at(5), 1.5).normalize(),
            log_scale: Vec3::new(-1.5 + 0.5 * at(6), -1.5 + 0.5 * at(7), -2.5 + at(8)),
            logit: 2.0 * at(9),
            harmonics,
        }
    };
    Cloud {
        splats: (0..count).map(splat).collect(),
        degree: 2,
    }
}

fn grey() -> Picture {
    Picture {
        pixels: vec![[0.4, 0.5, 0.6, 0.9]; (SIZE.0 * SIZE.1) as usize],
    }
}

/// The loss that [`error_backward`] returns, computed from the rendered picture.
fn error(cloud: &Cloud) -> f64 {
    let ours = render(cloud, &camera());
    let truth = grey();
    let pairs = ours.pixels.iter().zip(&truth.pixels).map(|(a, b)| {
        let square = |channel: usize| f64::from(a[channel] - b[channel]).powi(2);
        0.5 * (0..4).map(square).sum::<f64>()
    });
    pairs.sum()
}

#[test]
fn gradients_are_those_of_finite_differences() {
    let cloud = cloud(6);
    let (loss, by) = error_backward(&cloud, &camera(), &grey());
    assert!((loss - error(&cloud)).abs() < 1e-4 * loss, "{loss}");
    let numbers: [(&str, Number, Gradient); 6] = [
        ("logit", |s| &mut s.logit, |b| b.logit),
        ("first scale", |s| &mut s.log_scale.x, |b| b.log_scale.x),
        ("second scale", |s| &mut s.log_scale.y, |b| b.log_scale.y),
        ("third scale", |s| &mut s.log_scale.z, |b| b.log_scale.z),
        ("red", |s| &mut s.harmonics[0][0], |b| b.harmonics[0][0]),
        (
            "blue's turn",
            |s| &mut s.harmonics[5][2],
            |b| b.harmonics[5][2],
        ),
    ];
    for (name, number, gradient) in numbers {
        for (i, by) in by.iter().enumerate() {
            const STEP: f32 = 4e-3;
            let at = |offset: f32| {
                let mut moved = cloud.clone();
                *number(&mut moved.splats[i]) += offset;
                error(&moved)
            };
            let measured = (at(STEP) - at(-STEP)) / f64::from(2.0 * STEP);
            let told = f64::from(gradient(by));
            let apart = (measured - told).abs();
            assert!(
                apart < 0.01 * told.abs() + 0.01,
                "{name} of {i}: {told} {measured}"
            );
        }
    }
}

#[test]
fn a_splat_before_another_hides_it() {
    let mut cloud = cloud(2);
    for (splat, (z, red)) in cloud.splats.iter_mut().zip([(-3.0, 1.0), (-2.0, 0.0)]) {
        splat.position = Vec3::new(0.0, 0.0, z);
        splat.log_scale = Vec3::splat(0.0);
        splat.logit = 9.0;
        splat.harmonics = [[0.0; 3]; MOST];
        splat.harmonics[0] = [(red - 0.5) / 0.282_094_8; 3];
    }
    let middle = render(&cloud, &camera()).pixels[(12 * SIZE.0 + 20) as usize];
    assert!(middle[0] < 0.02 && middle[3] > 0.98, "{middle:?}");
}

#[test]
fn a_cloud_is_drawn_with_the_same_bits_by_any_number_of_threads() {
    let cloud = cloud(200);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            (
                render(&cloud, &camera()),
                error_backward(&cloud, &camera(), &grey()),
            )
        })
    };
    assert_eq!(on(1), on(3));
}
