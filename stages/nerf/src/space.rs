//! From world space to the unit space the field lives in. Knows nothing of what the field holds.

use crate::config::{CONE, FieldConfig};
use crate::perspective::{Perspective, reach};
use formats::Camera;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which space a scene gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum SpaceKind {
    /// [`SpaceKind::Perspective`] where all cameras look the same way, else [`SpaceKind::Box`].
    Auto,
    /// The scene box, scaled evenly: for what is photographed from all around.
    Box,
    /// What a camera at the front sees, with places in depth spread by disparity: for what is
    /// photographed from one side.
    Perspective,
}

/// The scene box and the map to unit space.
///
/// In a box the map is a shift and one *uniform* scale that makes the box's longest side 1, so that
/// cells stay cubes and a distance means the same in every direction; the shorter sides end
/// below 1. A scene photographed from one side may have a perspective map instead. Densities are
/// per unit length.
#[derive(Clone, Debug, PartialEq)]
pub struct Space {
    /// The box's lowest and highest corner in world space.
    pub bounds: [[f32; 3]; 2],
    /// The highest corner of unit space; its lowest is the origin.
    pub extent: [f32; 3],
    /// Unit lengths per world length in a box.
    scale: f32,
    perspective: Option<Perspective>,
}

impl Space {
    /// The space of a box with positive, finite sides.
    pub fn new(bounds: [[f32; 3]; 2]) -> Self {
        let sides: [f32; 3] = std::array::from_fn(|axis| bounds[1][axis] - bounds[0][axis]);
        let longest = sides.into_iter().fold(0.0, f32::max);
        assert!(
            sides.iter().all(|&side| side > 0.0 && side.is_finite()),
            "a scene box has no volume: {bounds:?}"
        );
        let scale = 1.0 / longest;
        Self {
            bounds,
            scale,
            extent: sides.map(|side| side * scale),
            perspective: None,
        }
    }

    /// The space of a scene box and the cameras that see the scene. `None` where a perspective is
    /// asked for and the cameras do not look the same way.
    pub fn of(kind: SpaceKind, bounds: [[f32; 3]; 2], cameras: &[&Camera]) -> Option<Self> {
        let perspective = || {
            Perspective::of(cameras).map(|(map, extent)| Self::in_perspective(bounds, map, extent))
        };
        match kind {
            SpaceKind::Auto => Some(perspective().unwrap_or_else(|| Self::new(bounds))),
            SpaceKind::Box => Some(Self::new(bounds)),
            SpaceKind::Perspective => perspective(),
        }
    }

    /// A space with a map of its own.
    pub(crate) fn in_perspective(
        bounds: [[f32; 3]; 2],
        map: Perspective,
        extent: [f32; 3],
    ) -> Self {
        Self {
            extent,
            perspective: Some(map),
            ..Self::new(bounds)
        }
    }

    /// The map, where it is not a shift and a scale.
    pub(crate) fn perspective(&self) -> Option<&Perspective> {
        self.perspective.as_ref()
    }

    /// The depths along its view axis between which a camera sees something.
    pub fn range(&self, camera: &Camera) -> [f64; 2] {
        if self.perspective.is_some() {
            reach(camera)
        } else {
            [camera.near, camera.far]
        }
    }

    /// A world point in unit space.
    pub fn to_unit(&self, point: [f32; 3]) -> [f32; 3] {
        if let Some(perspective) = &self.perspective {
            return perspective.to_unit(point);
        }
        std::array::from_fn(|axis| (point[axis] - self.bounds[0][axis]) * self.scale)
    }

    /// A point of unit space in world space.
    pub fn to_world(&self, unit: [f64; 3]) -> [f64; 3] {
        match &self.perspective {
            Some(perspective) => perspective.to_world(unit),
            None => {
                [0, 1, 2].map(|a| unit[a] / f64::from(self.scale) + f64::from(self.bounds[0][a]))
            }
        }
    }

    /// The gradient to a world point, from that to where it lies in unit space.
    pub fn to_unit_backward(&self, point: [f32; 3], d_unit: [f32; 3]) -> [f32; 3] {
        match &self.perspective {
            Some(perspective) => perspective.to_unit_backward(point, d_unit),
            None => d_unit.map(|d| d * self.scale),
        }
    }

    /// Growth of marching steps with the distance from the camera: equal steps in perspective are
    /// already steps of equal disparity.
    pub fn cone(&self, config: &FieldConfig) -> f64 {
        if self.perspective.is_some() {
            0.0
        } else {
            config.march_cone.unwrap_or(CONE)
        }
    }

    /// How far a camera is from the scene box, whose longest side is 1; 0 inside.
    pub(crate) fn distance_from_box(&self, camera: &Camera) -> f32 {
        let place = camera
            .camera_to_world
            .w_axis
            .truncate()
            .as_vec3()
            .to_array();
        let outside: [f32; 3] = std::array::from_fn(|axis| {
            let [low, high] = self.bounds.map(|corner| corner[axis]);
            (low - place[axis]).max(place[axis] - high).max(0.0) * self.scale
        });
        outside.iter().map(|x| x * x).sum::<f32>().sqrt()
    }

    /// Unit lengths per world length at a world point; in perspective, where it depends on the
    /// direction, along the front camera's axis.
    pub fn scale_at(&self, point: [f32; 3]) -> f32 {
        self.perspective
            .as_ref()
            .map_or(self.scale, |map| map.scale_at(point))
    }

    /// The part of `range` (distances in unit space) in which a ray is inside the box; empty if
    /// start >= end.
    pub fn clip(&self, origin: [f32; 3], direction: [f32; 3], range: [f32; 2]) -> [f32; 2] {
        let [mut start, mut end] = range;
        for axis in 0..3 {
            // A ray along a face divides by zero: the infinities keep or empty the range as they
            // should.
            let inverse = 1.0 / direction[axis];
            let a = -origin[axis] * inverse;
            let b = (self.extent[axis] - origin[axis]) * inverse;
            start = start.max(a.min(b));
            end = end.min(a.max(b));
        }
        [start, end]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_side_becomes_one_and_cells_stay_cubes() {
        let space = Space::new([[-2.0, 0.0, 1.0], [2.0, 1.0, 3.0]]);
        assert_eq!((space.scale, space.extent), (0.25, [1.0, 0.25, 0.5]));
        assert_eq!(space.to_unit([2.0, 0.0, 2.0]), [1.0, 0.0, 0.25]);
    }

    #[test]
    fn a_ray_is_cut_at_the_faces_and_at_its_own_range() {
        let space = Space::new([[0.0; 3], [1.0, 1.0, 0.5]]);
        let along_z = [0.0, 0.0, 1.0];
        assert_eq!(
            space.clip([0.5, 0.5, -1.0], along_z, [0.0, 9.0]),
            [1.0, 1.5]
        );
        assert_eq!(
            space.clip([0.5, 0.5, -1.0], along_z, [1.2, 1.3]),
            [1.2, 1.3]
        );
        let [start, end] = space.clip([2.0, 0.5, -1.0], along_z, [0.0, 9.0]);
        assert!(start >= end, "the ray passes beside the box");
    }
}
