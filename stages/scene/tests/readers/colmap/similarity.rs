//! Cameras of one scene in two worlds: the similarity between them.

use formats::Camera;
use glam::{DMat4, DVec3};

/// Whether what one camera sees at some pixel and depth, the next sees where it always did, up to
/// one scale.
pub fn assert_similar(known: &[Camera], read: &[Camera], pixels: f64) {
    let scale = read[0].position().distance(read[1].position())
        / known[0].position().distance(known[1].position());
    for i in 0..known.len() {
        let j = (i + 1) % known.len();
        let w = f64::from(known[i].width);
        let h = f64::from(known[i].height);
        for (px, py) in [(0.2 * w, 0.3 * h), (0.7 * w, 0.6 * h)] {
            let depth = 0.5 * (known[i].near + known[i].far);
            let was = known[j].project(known[i].unproject(px, py, depth)).unwrap();
            let is = read[j]
                .project(read[i].unproject(px, py, depth * scale))
                .unwrap();
            let off = (was[0] - is[0]).hypot(was[1] - is[1]);
            assert!(off < pixels, "{i}: {off} pixels off: {was:?} {is:?}");
        }
    }
}

/// Turns, moves and scales the world.
pub struct Similarity {
    pub turn: glam::DMat3,
    pub scale: f64,
    from: DVec3,
    to: DVec3,
}

impl Similarity {
    /// The one that takes cameras to cameras: by the mean position, the mean turn, and the spread.
    pub fn between(a: &[Camera], b: &[Camera]) -> Similarity {
        let mean = |cameras: &[Camera]| {
            cameras.iter().map(Camera::position).sum::<DVec3>() / cameras.len() as f64
        };
        let from = mean(a);
        let to = mean(b);
        let spread = |cameras: &[Camera], mean: DVec3| {
            cameras
                .iter()
                .map(|camera| camera.position().distance_squared(mean))
                .sum::<f64>()
                .sqrt()
        };
        let turn = |(a, b): (&Camera, &Camera)| -> DMat4 {
            b.camera_to_world * a.camera_to_world.inverse()
        };
        let sum = a
            .iter()
            .zip(b)
            .map(turn)
            .fold(DMat4::ZERO, |sum, turn| sum + turn);
        let axes = glam::DMat3::from_mat4(sum);
        let x = axes.x_axis.normalize();
        let y = (axes.y_axis - x * x.dot(axes.y_axis)).normalize();
        Similarity {
            turn: glam::DMat3::from_cols(x, y, x.cross(y)),
            scale: spread(b, to) / spread(a, from),
            from,
            to,
        }
    }

    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.to + self.scale * (self.turn * (point - self.from))
    }
}
