//! From world space to the unit space the field lives in. Knows nothing of what the field holds.

/// The scene box and its map to unit space.
///
/// The map is a shift and one *uniform* scale that makes the box's longest side 1, so that cells stay cubes and a
/// distance means the same in every direction; the shorter sides end below 1. Densities are per unit length.
#[derive(Clone, Debug, PartialEq)]
pub struct Space {
    /// The box's lowest and highest corner in world space.
    pub bounds: [[f32; 3]; 2],
    /// Unit lengths per world length.
    pub scale: f32,
    /// The box's highest corner in unit space; its lowest is the origin.
    pub extent: [f32; 3],
}

impl Space {
    /// The space of a box with positive, finite sides.
    pub fn new(bounds: [[f32; 3]; 2]) -> Self {
        let sides: [f32; 3] = std::array::from_fn(|axis| bounds[1][axis] - bounds[0][axis]);
        let longest = sides.into_iter().fold(0.0, f32::max);
        assert!(sides.iter().all(|&side| side > 0.0 && side.is_finite()), "a scene box has no volume: {bounds:?}");
        let scale = 1.0 / longest;
        Self { bounds, scale, extent: sides.map(|side| side * scale) }
    }

    /// A world point in unit space.
    pub fn to_unit(&self, point: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| (point[axis] - self.bounds[0][axis]) * self.scale)
    }

    /// The part of `range` (distances in unit space) in which a ray is inside the box; empty if start >= end.
    pub fn clip(&self, origin: [f32; 3], direction: [f32; 3], range: [f32; 2]) -> [f32; 2] {
        let [mut start, mut end] = range;
        for axis in 0..3 {
            // A ray along a face divides by zero: the infinities keep or empty the range as they should.
            let inverse = 1.0 / direction[axis];
            let (a, b) = (-origin[axis] * inverse, (self.extent[axis] - origin[axis]) * inverse);
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
        assert_eq!(space.clip([0.5, 0.5, -1.0], along_z, [0.0, 9.0]), [1.0, 1.5]);
        assert_eq!(space.clip([0.5, 0.5, -1.0], along_z, [1.2, 1.3]), [1.2, 1.3]);
        let [start, end] = space.clip([2.0, 0.5, -1.0], along_z, [0.0, 9.0]);
        assert!(start >= end, "the ray passes beside the box");
    }
}
