//! The scene, its photos, and a field for it.

use formats::{Camera, Pixels, Srgb};
use glam::DVec3;
use nerf::{Field, FieldConfig, Space, SpaceKind, TrainOptions, TrainView};

/// The box of the scene.
pub const BOUNDS: [[f32; 3]; 2] = [[-1.0; 3], [1.0; 3]];
const SPHERES: [([f64; 3], f64, [f32; 3]); 2] = [
    ([-0.3, 0.0, 0.1], 0.4, [0.9, 0.2, 0.1]),
    ([0.4, 0.1, -0.3], 0.35, [0.1, 0.4, 0.9]),
];

/// A camera that looks at the scene from all around.
pub fn camera(angle: f64, size: u32) -> Camera {
    let position = DVec3::new(3.0 * angle.sin(), 0.8, 3.0 * angle.cos());
    Camera::centered(
        (size, size),
        1.6 * f64::from(size),
        Camera::look_at(position, DVec3::ZERO),
        [1.0, 6.0],
    )
}

/// Distance and colour of the nearest sphere on a ray.
pub fn trace(camera: &Camera, px: f64, py: f64) -> Option<(f64, [f32; 3])> {
    let ray = camera.ray(px, py);
    let hit = |(center, radius, color): &([f64; 3], f64, [f32; 3])| {
        let o = ray.origin.map(f64::from);
        let d = ray.direction.map(f64::from);
        let to_center: [f64; 3] = std::array::from_fn(|i| center[i] - o[i]);
        let along: f64 = (0..3).map(|i| to_center[i] * d[i]).sum();
        let square: f64 = to_center.iter().map(|x| x * x).sum::<f64>() - along * along;
        let t = along - (radius * radius - square).max(0.0).sqrt();
        let height = (o[1] + t * d[1] - center[1]) / radius;
        (square < radius * radius).then(|| {
            (
                t / f64::from(ray.distance_per_depth),
                color.map(|c| c * (0.75 + 0.25 * height as f32)),
            )
        })
    };
    SPHERES
        .iter()
        .filter_map(hit)
        .min_by(|a, b| a.0.total_cmp(&b.0))
}

/// What a camera sees, with coverage, each pixel the mean of 4 x 4 rays.
pub fn seen(camera: Camera) -> Pixels<Srgb> {
    let mut rgb = vec![];
    let mut alpha = vec![];
    for pixel in 0..camera.width * camera.height {
        let x = f64::from(pixel % camera.width);
        let y = f64::from(pixel / camera.width);
        let place = |sub: u32| f64::from(sub) / 4.0 + 0.125;
        let hits: Vec<_> = (0..16)
            .filter_map(|s| trace(&camera, x + place(s % 4), y + place(s / 4)))
            .collect();
        let mean =
            |c: usize| hits.iter().map(|hit| hit.1[c]).sum::<f32>() / hits.len().max(1) as f32;
        rgb.extend([0, 1, 2].map(mean));
        alpha.push(hits.len() as f32 / 16.0);
    }
    Pixels::new(rgb, Some(alpha))
}

/// A photo to train on.
pub fn photo(camera: Camera) -> TrainView {
    TrainView {
        camera,
        pixels: seen(camera).into(),
        mask: None,
        weight: 1.0,
        supersample: 2,
    }
}

/// Eight photos from all around.
pub fn views() -> Vec<TrainView> {
    (0..8)
        .map(|i| photo(camera(f64::from(i) * std::f64::consts::TAU / 8.0, 32)))
        .collect()
}

/// Eight photos from one side.
pub fn from_one_side() -> Vec<TrainView> {
    (0..8)
        .map(|i| photo(camera(0.1 * f64::from(i) - 0.4, 32)))
        .collect()
}

/// A fresh field in the perspective of views from one side.
pub fn in_perspective(config: &FieldConfig, views: &[TrainView]) -> Field {
    let cameras: Vec<_> = views.iter().map(|view| &view.camera).collect();
    Field::in_space(
        config,
        Space::of(SpaceKind::Perspective, BOUNDS, &cameras).unwrap(),
        1,
    )
}

/// A field that trains in seconds: few levels, short tables, a coarse grid.
pub fn config() -> FieldConfig {
    FieldConfig {
        levels: 8,
        log2_table: 13,
        base_resolution: 12,
        finest_resolution: 96,
        occupancy_resolution: 32,
        march_steps: 96,
        march_cone: Some(0.0),
    }
}

/// How to train it.
pub fn options(steps: u32) -> TrainOptions {
    TrainOptions {
        steps,
        samples: 1 << 13,
        ..TrainOptions::default()
    }
}

/// Agreement of two images in dB.
pub fn psnr(a: &[f32], b: &[f32]) -> f64 {
    -10.0
        * (a.iter()
            .zip(b)
            .map(|(a, b)| f64::from((a - b) * (a - b)))
            .sum::<f64>()
            / a.len() as f64)
            .log10()
}
