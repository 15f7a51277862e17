//! What is looked at: fields, and the photos that they were made from. Knows nothing of browsers.

use artifacts_schema::View;
use formats::{Camera, rows};
use glam::DVec3;
use nerf::Field;
use serde_json::{Value, json};

/// A free camera sees from this part of the nearest near of all photos on, up to this many times
/// the farthest far: it may go nearer to things than any photo, and farther away.
const BEYOND: [f64; 2] = [0.1, 4.0];
/// Where a camera stands that has no photos to go by, from the middle of the box, and where its
/// range ends, in the box's longest side.
const APART: DVec3 = DVec3::new(0.5, 0.45, 1.2);
const RANGE: [f64; 2] = [0.05, 4.0];
/// The picture of such a camera, and its focal length.
const SIZE: (u32, u32) = (640, 480);
const FOCAL: f64 = 600.0;

/// Fields and photos of one scene.
pub struct Subject {
    /// One field or more, with their names.
    pub fields: Vec<(String, Field)>,
    /// Photos; there may be none.
    pub photos: Vec<View>,
    /// The photos' cameras; without photos, one that sees the box.
    pub cameras: Vec<Camera>,
    /// Near and far of a free camera.
    pub range: [f64; 2],
}

impl Subject {
    /// Fields, of which there is at least one, and photos, if there are any.
    pub fn new(first: (String, Field), others: Vec<(String, Field)>, photos: Vec<View>) -> Self {
        let mut cameras: Vec<Camera> = photos.iter().map(|photo| photo.camera).collect();
        if cameras.is_empty() {
            cameras.push(camera_of_box(first.1.bounds()));
        }
        // There is a camera in any case by now, so that neither end stays infinite.
        let near = cameras.iter().map(|camera| camera.near);
        let far = cameras.iter().map(|camera| camera.far);
        let range = [
            BEYOND[0] * near.fold(f64::INFINITY, f64::min),
            BEYOND[1] * far.fold(0.0, f64::max),
        ];
        let fields = std::iter::once(first).chain(others).collect();
        Self {
            fields,
            photos,
            cameras,
            range,
        }
    }

    /// The names of its fields.
    pub fn names(&self) -> Vec<&str> {
        self.fields.iter().map(|(name, _)| name.as_str()).collect()
    }

    /// All that a page has to know of it.
    pub fn card(&self) -> Value {
        let photos: Vec<&String> = self.photos.iter().map(|photo| &photo.name).collect();
        let cameras: Vec<Value> = self.cameras.iter().map(camera_card).collect();
        json!({
            "fields": self.names(),
            "photos": photos,
            "cameras": cameras,
            "focus": self.focus().to_array(),
            "up": scene::upwards(&self.cameras).to_array(),
        })
    }

    /// What the cameras look at; without photos, the middle of the box.
    fn focus(&self) -> DVec3 {
        if self.photos.is_empty() {
            middle(self.fields[0].1.bounds())
        } else {
            scene::focus(&self.cameras)
        }
    }
}

/// What a page has to know of a camera: its frustum is drawn, and it is the first of a flight.
fn camera_card(camera: &Camera) -> Value {
    json!({
        "w": camera.width, "h": camera.height,
        "fl_x": camera.fl_x, "fl_y": camera.fl_y, "cx": camera.cx, "cy": camera.cy,
        // The last row of a pose is 0 0 0 1 for every camera.
        "near": camera.near, "pose": rows::of(&camera.camera_to_world)[..3],
    })
}

fn camera_of_box(bounds: [[f32; 3]; 2]) -> Camera {
    let longest = (0..3)
        .map(|axis| f64::from(bounds[1][axis] - bounds[0][axis]))
        .fold(0.0, f64::max);
    let target = middle(bounds);
    let pose = Camera::look_at(target + longest * APART, target);
    Camera::centered(SIZE, FOCAL, pose, RANGE.map(|depth| depth * longest))
}

fn middle([low, high]: [[f32; 3]; 2]) -> DVec3 {
    0.5 * (DVec3::from(low.map(f64::from)) + DVec3::from(high.map(f64::from)))
}
