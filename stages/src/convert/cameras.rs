//! Cameras on disk and cameras that make rays: the same numbers, in two types that do not know each
//! other.

use artifacts_schema as disk;
use glam::DMat4;
use scene::{Camera, Distortion};

/// A camera that makes rays.
pub fn camera(camera: &disk::Camera) -> Camera {
    let bent = &camera.distortion;
    Camera {
        width: camera.width,
        height: camera.height,
        fl_x: camera.fl_x,
        fl_y: camera.fl_y,
        cx: camera.cx,
        cy: camera.cy,
        distortion: Distortion {
            k1: bent.k1,
            k2: bent.k2,
            k3: bent.k3,
            p1: bent.p1,
            p2: bent.p2,
            k4: bent.k4,
            k5: bent.k5,
            k6: bent.k6,
            fisheye: bent.fisheye,
        },
        camera_to_world: DMat4::from_cols_array_2d(&camera.camera_to_world).transpose(),
        near: camera.near,
        far: camera.far,
    }
}

/// A camera for disk; its matrix is stored by rows.
pub fn disk_camera(camera: &Camera) -> disk::Camera {
    let bent = &camera.distortion;
    disk::Camera {
        width: camera.width,
        height: camera.height,
        fl_x: camera.fl_x,
        fl_y: camera.fl_y,
        cx: camera.cx,
        cy: camera.cy,
        distortion: disk::Distortion {
            k1: bent.k1,
            k2: bent.k2,
            k3: bent.k3,
            p1: bent.p1,
            p2: bent.p2,
            k4: bent.k4,
            k5: bent.k5,
            k6: bent.k6,
            fisheye: bent.fisheye,
        },
        camera_to_world: camera.camera_to_world.transpose().to_cols_array_2d(),
        near: camera.near,
        far: camera.far,
    }
}

/// The same view with `scale` times the pixels along each axis, rounded to whole ones.
pub fn scaled(camera: &Camera, scale: f64) -> Camera {
    let pixels = |side: u32| ((f64::from(side) * scale).round() as u32).max(1);
    camera.scaled(pixels(camera.width), pixels(camera.height))
}
