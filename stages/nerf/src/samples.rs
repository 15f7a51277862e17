//! The samples of some rays, ray by ray. Knows where they are, and nothing of what is there.

use crate::field::Field;
use crate::march::{Segment, march};
use crate::positions::Positions;
use std::ops::Range;

/// Rays, and their samples from front to back.
#[derive(Default)]
pub struct Samples {
    /// By ray: its part inside the box.
    pub segments: Vec<Segment>,
    /// Which samples are a ray's.
    pub rays: Vec<Range<usize>>,
    /// By sample: its point in unit space.
    pub positions: Positions,
    /// Their distances from the camera.
    pub t: Vec<f32>,
    /// The lengths of their steps.
    pub dt: Vec<f32>,
}

impl Samples {
    /// Forgets all rays, and keeps the memory.
    pub fn clear(&mut self) {
        let Self {
            segments,
            rays,
            positions,
            t,
            dt,
        } = self;
        segments.clear();
        rays.clear();
        positions.clear();
        t.clear();
        dt.clear();
    }

    /// Adds a ray with a sample at every step where there may be something. `jitter` shifts its
    /// steps by a part of a step.
    pub fn march(&mut self, field: &Field, segment: Segment, jitter: f32) {
        let first = self.t.len();
        march(
            &field.occupancy,
            field.stride(),
            &segment,
            jitter,
            |t, dt| {
                // Rounding may put a point just below the box, where the grid has no cells.
                self.positions.push(segment.at(t).map(|x| x.max(0.0)));
                self.t.push(t);
                self.dt.push(dt);
            },
        );
        self.rays.push(first..self.t.len());
        self.segments.push(segment);
    }

    /// Drops all samples but those with these indices, and closes the gaps.
    pub fn keep(&mut self, kept: &[u32]) {
        let mut end = 0;
        for ray in &mut self.rays {
            let first = end;
            // Kept indices ascend, so a ray's are those before its end.
            end += kept[first..]
                .iter()
                .take_while(|&&sample| (sample as usize) < ray.end)
                .count();
            *ray = first..end;
        }
        let [x, y, z] = &mut self.positions.0;
        for values in [x, y, z, &mut self.t, &mut self.dt] {
            kept.iter()
                .enumerate()
                // Indices ascend, so that `from` is never before `to`: all is read before it is
                // written.
                .for_each(|(to, &from)| values[to] = values[from as usize]);
            values.truncate(kept.len());
        }
    }
}
