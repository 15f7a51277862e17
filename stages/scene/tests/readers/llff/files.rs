//! The files of an LLFF scene, written from known cameras.

use std::path::Path;

use formats::{Camera, Distortion};
use glam::DVec3;
use npyz::WriterBuilder;
use tempfile::TempDir;

use crate::common::{SIZE, write_photo};

pub fn known_cameras() -> Vec<Camera> {
    let target = DVec3::new(1.0, 2.0, -20.0);
    let positions = [
        DVec3::new(-2.0, 2.5, 1.0),
        DVec3::new(1.0, 1.5, 0.0),
        DVec3::new(4.0, 2.2, 0.5),
    ];
    let camera = |(i, position): (usize, DVec3)| Camera {
        width: SIZE.0,
        height: SIZE.1,
        fl_x: 30.0,
        fl_y: 30.0,
        cx: 12.0,
        cy: 9.0,
        distortion: Distortion::default(),
        camera_to_world: Camera::look_at(position, target),
        near: 10.0 + i as f64,
        far: 40.0 + i as f64,
    };
    positions.into_iter().enumerate().map(camera).collect()
}

/// A camera as LLFF stores it: axes [down, right, backwards], sizes of photos four times as large.
pub fn row(camera: &Camera) -> Vec<f64> {
    let pose = camera.camera_to_world;
    let right = pose.x_axis;
    let up = pose.y_axis;
    let back = pose.z_axis;
    let at = pose.w_axis;
    let full = [
        4.0 * f64::from(camera.height),
        4.0 * f64::from(camera.width),
        4.0 * camera.fl_x,
    ];
    let rows = (0..3).flat_map(|i| [-up[i], right[i], back[i], at[i], full[i]]);
    rows.chain([camera.near, camera.far]).collect()
}

pub fn write_poses(folder: &Path, rows: &[Vec<f64>]) {
    let shape = [rows.len() as u64, rows.first().map_or(17, Vec::len) as u64];
    let file = std::fs::File::create(folder.join("poses_bounds.npy")).unwrap();
    let mut npy = npyz::WriteOptions::new()
        .default_dtype()
        .shape(&shape)
        .writer(file)
        .begin_nd()
        .unwrap();
    npy.extend(rows.iter().flatten()).unwrap();
    npy.finish().unwrap();
}

pub fn written_scene() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_poses(
        folder.path(),
        &known_cameras().iter().map(row).collect::<Vec<_>>(),
    );
    std::fs::create_dir(folder.path().join("images_4")).unwrap();
    for i in [2, 0, 1] {
        write_photo(
            &folder.path().join(format!("images_4/photo{i}.png")),
            SIZE,
            100 + i,
        );
    }
    folder
}
