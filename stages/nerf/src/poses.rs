//! Where each photo was taken from: a small turn and a small shift of every given camera, learnt
//! with the field. Knows nothing of the field.

use formats::Camera;
use glam::{DMat3, DMat4, DQuat, DVec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::tensors::{FieldError, Tensors};
use crate::view_parameters::{self, ViewParameters, ViewVector};

/// The rate of the last step, as a part of the first's.
const FINAL: f64 = 0.01;
/// The name of the numbers among a trainer's tensors.
const NAME: &str = "trainer.poses";

/// How poses are refined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PoseOptions {
    /// Adam's rate at its highest, in radians and in parts of the distance that a camera looks at;
    /// it falls to a hundredth over the steps.
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub rate: f64,
    /// Steps before the first that moves a camera: a field that knows nothing yet has no say.
    pub start: u32,
}

/// Chosen by held-out PSNR of the still life at 96x72 with poses off by a hundredth, after 3000
/// steps: 22.05 dB at 0.00005, 22.17 at 0.0001, 22.07 at 0.0002, 21.57 at 0.0003 (20.34 without);
/// a batch has few pixels of a view, and higher rates follow their noise.
impl Default for PoseOptions {
    fn default() -> Self {
        Self {
            rate: 1e-4,
            start: 500,
        }
    }
}

/// What says where all cameras together are. Photos do not: a field that moves with them shows the
/// same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gauge {
    /// The poses as they are given: what the cameras' moves have in common is taken back.
    Given,
    /// A field that stays as it is.
    Field,
}

/// The poses of all views in training.
#[derive(Clone, Debug)]
pub struct Poses {
    options: PoseOptions,
    given: Vec<Camera>,
    /// What keeps the whole in place.
    pub gauge: Gauge,
    /// By view: a turn as twice a quaternion's vector part over its real part, which is nearly the
    /// rotation vector and needs no sine, and a shift in parts of the camera's distance.
    parameters: ViewParameters,
}

/// The distance at which a turn and a shift of one size move what is seen about as far: the
/// geometric mean of near and far.
fn distance(camera: &Camera) -> f64 {
    (camera.near * camera.far).sqrt()
}

fn halves(vector: &ViewVector) -> [DVec3; 2] {
    let [a, b, c, d, e, f] = vector.map(f64::from);
    [DVec3::new(a, b, c), DVec3::new(d, e, f)]
}

fn view_vector(turn: DVec3, shift: DVec3) -> ViewVector {
    let [a, b, c] = turn.as_vec3().to_array();
    let [d, e, f] = shift.as_vec3().to_array();
    [a, b, c, d, e, f]
}

/// A camera turned about itself and shifted.
fn placed(given: &Camera, numbers: &ViewVector) -> Camera {
    let [turn, shift] = halves(numbers);
    let half = 0.5 * turn;
    // (turn / 2, 1), brought to unit length, is the quaternion: no sine, no case for small turns.
    let rotation = DMat3::from_quat(DQuat::from_xyzw(half.x, half.y, half.z, 1.0).normalize());
    let axes = rotation * DMat3::from_mat4(given.camera_to_world);
    let mut camera_to_world = DMat4::from_mat3(axes);
    let position = given.position() + distance(given) * shift;
    camera_to_world.w_axis = position.extend(1.0);
    Camera {
        camera_to_world,
        ..*given
    }
}

/// The gradient to a view's six numbers, from that to a turn of the camera about itself where it
/// stands now (a torque) and to its place (a force).
fn placed_backward(given: &Camera, numbers: &ViewVector, pull: &ViewVector) -> ViewVector {
    let [torque, force] = halves(pull);
    let half = 0.5 * halves(numbers)[0];
    // The derivative of that rotation by the numbers, turned over.
    let turn = (torque - half.cross(torque)) / (1.0 + half.length_squared());
    view_vector(turn, distance(given) * force)
}

impl Poses {
    /// As they are given.
    pub fn new(options: &PoseOptions, given: Vec<Camera>) -> Self {
        Self {
            options: options.clone(),
            parameters: ViewParameters::new(given.len()),
            given,
            gauge: Gauge::Given,
        }
    }

    /// The camera of a view as it is now.
    pub fn camera(&self, view: usize) -> Camera {
        placed(&self.given[view], &self.parameters.values[view])
    }

    /// Whether the step after so many moves cameras.
    pub fn move_after(&self, steps: u32) -> bool {
        steps >= self.options.start
    }

    /// The step after so many, of `all`: sums torques and forces by view in the order of the parts,
    /// and moves the cameras against them.
    pub fn descend<'a>(
        &mut self,
        parts: impl Iterator<Item = &'a Vec<ViewVector>>,
        steps: u32,
        all: u32,
    ) {
        let pulls = view_parameters::sum(self.given.len(), parts);
        let views = self.given.iter().zip(&self.parameters.values).zip(&pulls);
        let gradient: Vec<ViewVector> = views
            .map(|((given, numbers), pull)| placed_backward(given, numbers, pull))
            .collect();
        let done = steps.saturating_sub(self.options.start);
        let progress = f64::from(done) / f64::from(all.saturating_sub(self.options.start).max(1));
        let rate = self.options.rate * FINAL.powf(progress.min(1.0));
        self.parameters.step(&gradient, rate, done + 1);
        if self.gauge == Gauge::Given {
            // After Adam, whose steps differ by camera and so move the whole.
            self.fix_gauge();
        }
    }

    /// Takes back the similarity that all cameras have in common: a turn, a shift and a growth about
    /// their middle, to first order and by least squares over places and turns. Photos do not
    /// determine it (the gauge freedom of bundle adjustment), and cameras that are not refined with
    /// these stay valid.
    fn fix_gauge(&mut self) {
        let count = self.given.len() as f64;
        let middle = self.given.iter().map(Camera::position).sum::<DVec3>() / count;
        let scale = self.given.iter().map(distance).sum::<f64>() / count;
        let moves: Vec<[DVec3; 3]> = self
            .given
            .iter()
            .zip(&self.parameters.values)
            .map(|(given, numbers)| {
                let [turn, shift] = halves(numbers);
                [
                    (given.position() - middle) / scale,
                    turn,
                    shift * distance(given) / scale,
                ]
            })
            .collect();
        let common = Similarity::of(&moves);
        let own = self
            .given
            .iter()
            .zip(self.parameters.values.iter_mut())
            .zip(&moves);
        for ((given, numbers), [place, turn, shift]) in own {
            let shift = *shift - common.shift_at(*place);
            *numbers = view_vector(*turn - common.turn, shift * scale / distance(given));
        }
    }

    /// All parameters and their moments.
    pub fn tensors(&self) -> Tensors {
        self.parameters.tensors(NAME)
    }

    /// Takes up what [`Poses::tensors`] gave.
    pub fn read(&mut self, tensors: &Tensors) -> Result<(), FieldError> {
        self.parameters.read(NAME, tensors)
    }
}

/// A similarity of the world to first order: what moves of several cameras have in common.
struct Similarity {
    turn: DVec3,
    shift: DVec3,
    growth: f64,
}

impl Similarity {
    /// Of places about their middle, turns and shifts. The three parts do not mix in the sum of
    /// squares, since places have no mean and a turn moves at right angles to them.
    fn of(moves: &[[DVec3; 3]]) -> Self {
        let mut normal = DMat3::ZERO;
        let mut turn = DVec3::ZERO;
        let mut along = [0.0, 0.0];
        let mut shift = DVec3::ZERO;
        for [place, turned, shifted] in moves {
            // p p^T; |p|^2 - p p^T is what a turn about the middle moves at p.
            let outer = DMat3::from_cols(*place * place.x, *place * place.y, *place * place.z);
            normal += DMat3::IDENTITY * (1.0 + place.length_squared()) - outer;
            turn += *turned + place.cross(*shifted);
            along[0] += place.dot(*shifted);
            along[1] += place.length_squared();
            shift += *shifted;
        }
        Self {
            turn: normal.inverse() * turn,
            shift: shift / moves.len() as f64,
            // A single place grows by nothing.
            growth: if along[1] > 0.0 {
                along[0] / along[1]
            } else {
                0.0
            },
        }
    }

    fn shift_at(&self, place: DVec3) -> DVec3 {
        self.shift + self.turn.cross(place) + self.growth * place
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cameras() -> Vec<Camera> {
        (0..5)
            .map(|i| {
                let angle = f64::from(i);
                let place = DVec3::new(3.0 * angle.sin(), 0.2 * angle, 3.0 * angle.cos());
                let pose = Camera::look_at(place, DVec3::ZERO);
                Camera::centered((8, 8), 8.0, pose, [1.0 + 0.1 * angle, 6.0])
            })
            .collect()
    }

    #[test]
    fn the_gradient_to_the_six_numbers_matches_finite_differences() {
        let given = cameras()[1];
        let numbers = [0.3, -0.2, 0.4, 0.01, 0.02, -0.03];
        let inside = DVec3::new(0.4, -0.3, -2.0);
        let slope = DVec3::new(0.7, -1.1, 0.4);
        let point = |numbers: &ViewVector| {
            let camera = placed(&given, numbers);
            camera.camera_to_world.transform_point3(inside)
        };
        let camera = placed(&given, &numbers);
        let torque = (point(&numbers) - camera.position()).cross(slope);
        let analytic = placed_backward(&given, &numbers, &view_vector(torque, slope));
        for i in 0..6 {
            let value = |step: f32| {
                let mut moved = numbers;
                moved[i] += step;
                slope.dot(point(&moved))
            };
            let numeric = (value(1e-3) - value(-1e-3)) / 2e-3;
            assert!(
                (numeric - f64::from(analytic[i])).abs() < 2e-3,
                "{i}: {numeric} {analytic:?}"
            );
        }
    }

    #[test]
    fn numbers_of_zero_leave_cameras_as_they_are_given() {
        let poses = Poses::new(&PoseOptions::default(), cameras());
        let back = poses.camera(2).camera_to_world;
        assert!(back.abs_diff_eq(cameras()[2].camera_to_world, 1e-12));
    }

    #[test]
    fn what_all_cameras_have_in_common_is_taken_back_and_what_one_has_alone_is_not() {
        let turn = DVec3::new(1e-4, -2e-4, 3e-4);
        let moved = |own: f64| {
            let mut poses = Poses::new(&PoseOptions::default(), cameras());
            for (i, given) in cameras().iter().enumerate() {
                let place = given.position();
                let shift = turn.cross(place) + 2e-4 * place + DVec3::splat(3e-4);
                let own = if i == 3 { own } else { 0.0 };
                poses.parameters.values[i] =
                    view_vector(turn, shift / distance(given) + DVec3::Y * own);
            }
            poses.fix_gauge();
            poses.parameters.values
        };
        let most = |numbers: &[f32]| numbers.iter().fold(0.0f32, |most, x| most.max(x.abs()));
        assert!(most(moved(0.0).as_flattened()) < 1e-7);
        assert!(most(&moved(1e-2)[3]) > 4e-3);
    }
}
