//! Inputs of the kinds that people bring, each with what they expect: how many photos are read,
//! what a warning says, what a refusal says.

mod lenses;
mod paths;
mod photos;
mod reconstructions;

use crate::common::words;
use formats::Camera;
use glam::DVec3;
use image::{DynamicImage, ImageFormat, Rgb, RgbImage};
use scene::{Reader, SceneData, Transforms};
use serde_json::{Value, json};
use std::path::Path;
use tempfile::TempDir;

const SIZE: (u32, u32) = (16, 12);

/// Cameras on a ring of radius 3 that look at the origin.
fn ring(count: usize) -> Vec<Camera> {
    let camera = |i: usize| {
        let angle = std::f64::consts::TAU * i as f64 / count as f64;
        let position = DVec3::new(3.0 * angle.sin(), 0.6, 3.0 * angle.cos());
        Camera::centered(
            SIZE,
            15.0,
            Camera::look_at(position, DVec3::ZERO),
            [1.0, 5.0],
        )
    };
    (0..count).map(camera).collect()
}

fn photo(i: usize) -> RgbImage {
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        Rgb([x as u8 * 15, y as u8 * 20, i as u8])
    })
}

fn save(image: impl Into<DynamicImage>, path: &Path, format: ImageFormat) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.into().save_with_format(path, format).unwrap();
}

/// Nine photos and their `transforms.json`, changed.
fn capture(change: impl Fn(&mut Value)) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let frame = |(i, camera): (usize, &Camera)| {
        let name = format!("images/{i:04}.png");
        save(photo(i), &folder.path().join(&name), ImageFormat::Png);
        let rows = camera.camera_to_world.transpose().to_cols_array_2d();
        json!({"file_path": name, "transform_matrix": rows})
    };
    let frames: Vec<Value> = ring(9).iter().enumerate().map(frame).collect();
    let (w, h) = SIZE;
    let mut page = json!({"fl_x": 15.0, "w": w, "h": h, "aabb_scale": 4, "frames": frames});
    change(&mut page);
    std::fs::write(folder.path().join("transforms.json"), page.to_string()).unwrap();
    folder
}

/// The text of the file, changed.
fn rewrite(folder: &TempDir, change: impl Fn(String) -> Vec<u8>) {
    let path = folder.path().join("transforms.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(path, change(text)).unwrap();
}

fn transforms(folder: &TempDir) -> Result<SceneData, scene::SceneError> {
    let path = folder.path().to_owned();
    Transforms {
        path,
        ..Transforms::default()
    }
    .read()
}

/// The photos read, and the notes as one text.
fn read(folder: &TempDir) -> (usize, String) {
    let scene = transforms(folder).unwrap();
    (
        scene.photos.len() + scene.test.len(),
        scene.notes.join("\n"),
    )
}

fn refusal(folder: &TempDir) -> String {
    words(transforms(folder).unwrap_err(), folder.path())
}

#[track_caller]
fn holds(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part} is not in: {text}");
    }
}

fn for_frames(page: &mut Value, change: impl Fn(usize, &mut Value)) {
    let frames = page["frames"].as_array_mut().unwrap();
    frames
        .iter_mut()
        .enumerate()
        .for_each(|(i, frame)| change(i, frame));
}
