//! Where along a ray the field is sampled. Knows the occupancy grid, and nothing of densities or
//! colours.

use formats::{Camera, Ray};

use crate::occupancy::OccupancyGrid;
use crate::perspective::Perspective;
use crate::space::Space;

/// The part of a ray inside the box and between near and far, in unit space.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// The camera's position; in perspective, where the ray enters.
    pub origin: [f32; 3],
    /// Unit vector in unit space, which is not the world's in perspective.
    pub direction: [f32; 3],
    /// First and last distance from the origin; empty if the first is not less.
    pub range: [f32; 2],
    /// Unit vector in world space, which colours depend on.
    pub view: [f32; 3],
    /// How the world depth along the view axis follows from the unit-space distance t: (a + b t) /
    /// (1 + c t).
    pub depth: [f32; 3],
}

impl Segment {
    /// The segment of a camera's ray through the image point (`px`, `py`).
    pub fn new(space: &Space, camera: &Camera, px: f64, py: f64) -> Self {
        let ray = camera.ray(px, py);
        let depths = space.range(camera).map(|depth| depth as f32);
        if let Some(perspective) = space.perspective() {
            return Self::in_perspective(space, perspective, &ray, depths);
        }
        let origin = space.to_unit(ray.origin);
        let distance_per_depth = ray.distance_per_depth * space.scale_at(ray.origin);
        let range = space.clip(
            origin,
            ray.direction,
            depths.map(|depth| depth * distance_per_depth),
        );
        Self {
            origin,
            direction: ray.direction,
            range,
            view: ray.direction,
            depth: [0.0, 1.0 / distance_per_depth, 0.0],
        }
    }

    /// The segment of a ray in perspective; distances start at its near plane.
    fn in_perspective(
        space: &Space,
        perspective: &Perspective,
        ray: &Ray,
        depths: [f32; 2],
    ) -> Self {
        let range = depths.map(|depth| depth * ray.distance_per_depth);
        let ends = perspective.behind_front(ray.origin, ray.direction, range);
        let at = |s: f32| [0, 1, 2].map(|axis| ray.origin[axis] + s * ray.direction[axis]);
        let [first, last] = ends.map(at);
        let origin = space.to_unit(first);
        let end = space.to_unit(last);
        let way: [f32; 3] = std::array::from_fn(|axis| end[axis] - origin[axis]);
        let length = way.iter().map(|x| x * x).sum::<f32>().sqrt();
        // Written so that NaN counts as nowhere.
        let nowhere = !(ends[0] < ends[1] && length > 0.0);
        let direction = way.map(|x| x / length);
        // Linear in the distance are 1 over the depth before the front camera, and the depth before
        // this one over that.
        let growth = perspective.depth(first) / perspective.depth(last);
        let [near, far] = ends.map(|s| s / ray.distance_per_depth);
        let depth = [
            near,
            (far * growth - near) / length,
            (growth - 1.0) / length,
        ];
        let range = if nowhere {
            [0.0; 2]
        } else {
            space.clip(origin, direction, [0.0, length])
        };
        Self {
            origin,
            direction,
            range,
            view: ray.direction,
            depth,
        }
    }

    /// The world depth along the view axis at distance `t`.
    pub fn depth(&self, t: f32) -> f32 {
        let [a, b, c] = self.depth;
        (a + b * t) / (1.0 + c * t)
    }

    /// The point at distance `t`.
    #[inline]
    pub fn at(&self, t: f32) -> [f32; 3] {
        std::array::from_fn(|axis| self.origin[axis] + t * self.direction[axis])
    }

    /// How far along its range a distance is, from 0 to 1.
    pub fn fraction(&self, t: f32) -> f32 {
        (t - self.range[0]) / (self.range[1] - self.range[0])
    }
}

/// The lengths of marching steps.
#[derive(Clone, Copy, Debug)]
pub struct Stride {
    /// The shortest step, in unit space.
    pub shortest: f32,
    /// Growth of the step with the distance from the camera.
    pub cone: f32,
}

impl Stride {
    /// The step at distance `t`.
    #[inline]
    pub fn at(&self, t: f32) -> f32 {
        // Far from the origin a step must still be more than rounding, or the march would stand
        // still.
        (t * self.cone).max(self.shortest).max(t * 1e-6)
    }
}

/// Calls `visit` with the middle and the length of every step that ends up in an occupied cell,
/// front to back. The first step starts `jitter` steps behind the segment's start.
#[inline]
pub fn march(
    grid: &OccupancyGrid,
    stride: Stride,
    segment: &Segment,
    jitter: f32,
    mut visit: impl FnMut(f32, f32),
) {
    let [start, end] = segment.range;
    let mut t = start + jitter * stride.at(start);
    // Written so that a range that is not a number ends the march at once.
    while t < end {
        let dt = stride.at(t);
        let middle = t + 0.5 * dt;
        // At the middle: both ends may lie in other cells.
        let point = segment.at(middle);
        let cell = grid.cell(point);
        if grid.occupied(cell) {
            visit(middle, dt);
            t += dt;
            continue;
        }
        // Whole steps, so that a cell that falls empty does not shift the samples behind it.
        let exit = exit(grid, segment, cell);
        t += dt;
        while t + 0.5 * stride.at(t) < exit {
            t += stride.at(t);
        }
    }
}

/// The distance at which a ray leaves a cell.
#[inline]
fn exit(grid: &OccupancyGrid, segment: &Segment, cell: [usize; 3]) -> f32 {
    let leave = |axis: usize| {
        let direction = segment.direction[axis];
        let face = if direction > 0.0 {
            cell[axis] + 1
        } else {
            cell[axis]
        } as f32
            / grid.resolution;
        // Along a face a ray leaves by another one.
        if direction == 0.0 {
            f32::INFINITY
        } else {
            (face - segment.origin[axis]) / direction
        }
    };
    leave(0).min(leave(1)).min(leave(2)).min(segment.range[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn segment(origin: [f32; 3], direction: [f32; 3], range: [f32; 2]) -> Segment {
        let length = direction.iter().map(|x| x * x).sum::<f32>().sqrt();
        Segment {
            origin,
            direction: direction.map(|x| x / length),
            range,
            view: direction,
            depth: [0.0, 1.0, 0.0],
        }
    }

    fn collect(
        grid: &OccupancyGrid,
        stride: Stride,
        segment: &Segment,
        jitter: f32,
    ) -> Vec<(f32, f32)> {
        let mut steps = vec![];
        march(grid, stride, segment, jitter, |t, dt| steps.push((t, dt)));
        steps
    }

    #[test]
    fn a_full_grid_is_sampled_at_every_step() {
        let grid = OccupancyGrid::new(8, &Space::new([[0.0; 3], [1.0; 3]]));
        let stride = Stride {
            shortest: 0.125,
            cone: 0.0,
        };
        let steps = collect(
            &grid,
            stride,
            &segment([0.5, 0.5, -1.0], [0.0, 0.0, 1.0], [1.0, 2.0]),
            0.0,
        );
        assert_eq!(steps.len(), 8);
        assert_eq!(steps[0], (1.0625, 0.125));
    }

    #[test]
    fn steps_grow_with_distance() {
        let stride = Stride {
            shortest: 0.01,
            cone: 0.1,
        };
        assert_eq!((stride.at(0.05), stride.at(2.0)), (0.01, 0.2));
    }

    proptest! {
        /// Skipping empty cells visits exactly the steps of a plain march whose middles are in
        /// occupied cells.
        #[test]
        fn skipping_loses_nothing(
            direction in prop::array::uniform3(-1.0..1.0f32),
            empty in prop::collection::vec(0..512u32, 100..500),
            jitter in 0.0..1.0f32,
            cone in 0.0..0.05f32,
        ) {
            prop_assume!(direction.iter().map(|x| x * x).sum::<f32>() > 0.1);
            let space = Space::new([[0.0; 3], [1.0; 3]]);
            let mut grid = OccupancyGrid::new(8, &space);
            for _ in 0..200 { grid.update(&empty, &vec![0.0; empty.len()]); }
            let mut ray = segment([0.5; 3], direction, [0.0, 9.0]);
            ray.range = space.clip(ray.origin, ray.direction, ray.range);
            let stride = Stride { shortest: 0.01, cone };
            let mut plain = vec![];
            let mut t = ray.range[0] + jitter * stride.at(ray.range[0]);
            while t < ray.range[1] {
                let dt = stride.at(t);
                if grid.occupied(grid.cell(ray.at(t + 0.5 * dt))) { plain.push((t + 0.5 * dt, dt)); }
                t += dt;
            }
            let skipping = collect(&grid, stride, &ray, jitter);
            // A middle within rounding of a face may fall to either side.
            prop_assert!(plain.len().abs_diff(skipping.len()) <= 1, "{} {}", plain.len(), skipping.len());
            prop_assert!(skipping.iter().all(|step| plain.contains(step)) || plain.iter().all(|step| skipping.contains(step)));
        }
    }
}
