//! Samples trained and rays rendered per second, on views of a textured wall: `cargo bench -p nerf`.

use glam::{DMat4, DVec3};
use nerf::{Field, FieldConfig, RenderOptions, TrainOptions, TrainView, Trainer, render};
use scene::Camera;
use std::time::Instant;

const STEPS: u32 = 300;

fn view(i: u32) -> TrainView {
    let position = DVec3::new(0.2 * f64::from(i % 3) - 0.2, 0.2 * f64::from(i / 3) - 0.2, 2.0);
    let (width, height) = (64, 48);
    let camera_to_world = DMat4::from_translation(position);
    let camera =
        Camera { width, height, fl_x: 60.0, fl_y: 60.0, cx: 32.0, cy: 24.0, camera_to_world, near: 1.0, far: 3.0 };
    let wave = |x: f64, c: usize| (0.5 + 0.4 * (9.0 * x + c as f64).sin()) as f32;
    let color = |pixel: u32| {
        let at = camera.unproject(f64::from(pixel % width) + 0.5, f64::from(pixel / width) + 0.5, position.z);
        [wave(at[0], 0), wave(at[1], 1), wave(at[0] + at[1], 2)]
    };
    TrainView { rgb: (0..width * height).flat_map(color).collect(), camera, alpha: None, weight: 1.0, supersample: 2 }
}

fn main() {
    for (name, log2_table, finest_resolution) in [("tables of 2^16", 16, 256), ("tables of 2^19", 19, 2048)] {
        let config = FieldConfig { log2_table, finest_resolution, ..FieldConfig::default() };
        let field = Field::new(&config, [[-1.5, -1.5, -1.0], [1.5, 1.5, 1.0]], 0);
        let views: Vec<TrainView> = (0..9).map(view).collect();
        let camera = views[4].camera.scaled(256, 192);
        let mut trainer = Trainer::new(field, views, &TrainOptions { steps: STEPS, ..TrainOptions::default() }, 0);
        let (start, mut samples, mut psnr) = (Instant::now(), 0, 0.0);
        for _ in 0..STEPS {
            let stats = trainer.step();
            (samples, psnr) = (samples + stats.samples, stats.psnr);
        }
        let seconds = start.elapsed().as_secs_f64();
        println!("{name}: trained {:.3} million samples a second, {psnr:.1} dB", samples as f64 / seconds / 1e6);
        let start = Instant::now();
        let image = render(trainer.field(), &camera, &RenderOptions::default());
        let rays = f64::from(image.width * image.height) / start.elapsed().as_secs_f64();
        println!("{name}: rendered {:.3} million rays a second", rays / 1e6);
    }
}
