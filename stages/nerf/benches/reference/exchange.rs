//! Hands a task to `reference.py` as files and reads its answer. Knows file formats, and nothing of
//! either renderer.

use crate::{Outcome, Task};
use nerf::{Field, Segment, Space, Trainer};
use scene::Photo;
use serde_json::json;
use std::error::Error;
use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

const SCRIPT: &str = include_str!("reference.py");

/// Runs the reference on a task; what it measured, and its images of the held-out views.
pub fn reference(python: &OsStr, task: &Task) -> Result<Outcome, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    write(folder.path(), task)?;
    let script = folder.path().join("reference.py");
    std::fs::write(&script, SCRIPT)?;
    let mut child = Command::new(python)
        .arg(&script)
        .arg(folder.path())
        .stdout(Stdio::piped())
        .spawn()?;
    let output = BufReader::new(child.stdout.take().ok_or("the reference has no output")?);
    // Read to its end before the child is waited for: one whose pipe is full would never end.
    let marks = output
        .lines()
        .map(|line| Ok(serde_json::from_str(&line?)?))
        .collect::<Result<_, Box<dyn Error>>>();
    if !child.wait()?.success() {
        return Err("the reference failed".into());
    }
    let mut values = read(&folder.path().join("reference.f32"))?.into_iter();
    let pixels = |photo: &Photo| values.by_ref().take(photo.pixels.rgb.len()).collect();
    Ok((marks?, task.test.iter().map(pixels).collect()))
}

fn write(folder: &Path, task: &Task) -> Result<(), Box<dyn Error>> {
    let space = &task.space;
    for (name, photos) in [("train", &task.train), ("test", &task.test)] {
        floats(
            &folder.join(format!("{name}.rays.f32")),
            photos.iter().flat_map(|photo| rays(space, photo)),
        )?;
        floats(
            &folder.join(format!("{name}.rgba.f32")),
            photos.iter().flat_map(rgba),
        )?;
    }
    let (size, occupancy) = fresh_occupancy(task);
    floats(&folder.join("occupancy.f32"), occupancy)?;
    let level = |level: &nerf::Level| json!({ "scale": level.scale, "resolution": level.resolution, "dense": level.dense, "entries": level.entries });
    let levels: Vec<_> = task.config.levels(space.extent).iter().map(level).collect();
    let scene = json!({
        "config": task.config, "march_cone": task.space.cone(&task.config), "options": task.options, "levels": levels, "occupancy_size": size,
        "test_views": task.test.len(), "background": task.background, "marks": task.marks,
    });
    Ok(std::fs::write(
        folder.join("scene.json"),
        scene.to_string(),
    )?)
}

/// Per pixel: origin, direction, first and last distance, in unit space; the direction in the
/// world.
fn rays(space: &Space, photo: &Photo) -> Vec<f32> {
    let camera = &photo.camera;
    let ray = |i: u32| {
        let px = f64::from(i % camera.width) + 0.5;
        let py = f64::from(i / camera.width) + 0.5;
        let Segment {
            origin: [x, y, z],
            direction: [dx, dy, dz],
            range: [start, end],
            view: [u, v, w],
            ..
        } = Segment::new(space, camera, px, py);
        [x, y, z, dx, dy, dz, start, end, u, v, w]
    };
    (0..camera.width * camera.height).flat_map(ray).collect()
}

/// Colours and coverage, pixel by pixel.
fn rgba(photo: &Photo) -> impl Iterator<Item = f32> + '_ {
    let pixel = |(i, rgb): (usize, &[f32; 3])| {
        let [r, g, b] = *rgb;
        [r, g, b, photo.pixels.coverage(i)]
    };
    photo
        .pixels
        .rgb
        .as_chunks()
        .0
        .iter()
        .enumerate()
        .flat_map(pixel)
}

/// The occupancy grid before training: where no camera looks, it is negative.
fn fresh_occupancy(task: &Task) -> (Vec<usize>, Vec<f32>) {
    let field = Field::in_space(&task.config, task.space.clone(), 0);
    let trainer = Trainer::new(field, task.views(), &task.options, 0);
    let (shape, values) = trainer
        .field()
        .tensors()
        .remove("occupancy")
        .unwrap_or_default();
    (shape.into_iter().rev().collect(), values)
}

fn floats(file: &Path, values: impl IntoIterator<Item = f32>) -> std::io::Result<()> {
    std::fs::write(
        file,
        values
            .into_iter()
            .flat_map(f32::to_le_bytes)
            .collect::<Vec<u8>>(),
    )
}

fn read(file: &Path) -> std::io::Result<Vec<f32>> {
    Ok(std::fs::read(file)?
        .as_chunks::<4>()
        .0
        .iter()
        .map(|&bytes| f32::from_le_bytes(bytes))
        .collect())
}
