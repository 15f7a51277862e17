//! Keeps a field's occupancy grid true while the field changes. Knows cameras and densities, and
//! nothing of losses.

use crate::features::Features;
use crate::field::Field;
use crate::network::Activations;
use crate::occupancy::elements;
use crate::pool::Pool;
use compute::rng::Rng;
use formats::Camera;
use glam::DVec3;
use rayon::prelude::*;

/// Updates that measure every cell, before sampling starts.
const WARM_UP: u32 = 16;
/// After the warm-up an update measures one in so many of the seen cells, and at as many of the
/// occupied ones.
const SHARE: usize = 8;
/// Cells one task measures: enough for a level of the hash grid to be worth fetching, and not too
/// many to remember.
const CHUNK: usize = 4096;

/// Scratch space of a task: the features of its cells, and the density network's activations.
pub type UpdateScratch = (Features, Activations);

/// Marks the cells that no camera can see, between its near and far and within its image, as empty
/// for good.
pub fn mark_unseen_cells(field: &mut Field, cameras: &[&Camera]) {
    let grid = &field.occupancy;
    let views: Vec<_> = cameras
        .iter()
        .map(|camera| (camera, camera.view_window(), field.space.range(camera)))
        .collect();
    let seen: Vec<bool> = (0..grid.cells())
        .into_par_iter()
        .map(|cell| {
            let world = |fraction: [f32; 3]| {
                field
                    .space
                    .to_world(grid.point(cell, fraction).map(f64::from))
            };
            let center = world([0.5; 3]);
            // A cell is a box in unit space; in perspective it is a frustum in the world, so its
            // radius is taken from its corners there.
            let corner =
                |i: usize| DVec3::from(world([i & 1, i >> 1 & 1, i >> 2].map(|side| side as f32)));
            let radius = (0..8)
                .map(|i| corner(i).distance(center.into()))
                .fold(0.0, f64::max);
            views
                .iter()
                .any(|(camera, window, range)| sees(camera, *window, *range, center, radius))
        })
        .collect();
    field.occupancy.set_seen(&seen);
}

/// Whether any of a ball around a world point may be in a camera's view, of which `window` is its
/// own, between two depths.
fn sees(
    camera: &Camera,
    window: [f64; 4],
    [near, far]: [f64; 2],
    center: [f64; 3],
    radius: f64,
) -> bool {
    let to_camera = camera.camera_to_world.inverse();
    let p = to_camera.transform_point3(center.into());
    let depth = -p.z;
    if depth + radius < near || depth - radius > far {
        return false;
    }
    // The distance to each side plane of the view, of which (1, -side) is the normal in the plane
    // of one axis.
    let inside = |across: f64, low: f64, high: f64| {
        across - low * depth > -radius * low.hypot(1.0)
            && high * depth - across > -radius * high.hypot(1.0)
    };
    inside(p.x, window[0], window[1]) && inside(p.y, window[2], window[3])
}

/// One update of the grid: all seen cells at first, then some at random and some of the occupied,
/// each at a random point in it. The optical depth of a cell is that of the shortest marching step.
pub fn update(field: &mut Field, rng: &Rng, scratch: &Pool<UpdateScratch>) {
    let round = u64::from(field.occupancy.updates);
    let cells = cells_to_update(field, rng, round);
    let shortest = field.stride().shortest;
    let fresh: Vec<f32> = cells
        // Fixed chunks, joined in their order: threads change nothing.
        .par_chunks(CHUNK)
        .map(|cells| scratch.lend(|scratch| densities(field, cells, scratch, rng, round)))
        .collect::<Vec<_>>()
        .concat();
    // In steps of the shortest: longer ones far from a camera only show more.
    let optical_depths: Vec<f32> = fresh.iter().map(|sigma| sigma * shortest).collect();
    field.occupancy.update(&cells, &optical_depths);
}

fn cells_to_update(field: &Field, rng: &Rng, round: u64) -> Vec<u32> {
    let seen = field.occupancy.seen_cells();
    // At first nothing is known: measuring a part of the cells would leave the others marked as
    // occupied, and rays would march through them.
    if field.occupancy.updates < WARM_UP {
        return seen;
    }
    let mut set = vec![0u64; field.occupancy.cells().div_ceil(64)];
    for (part, from) in [seen, field.occupancy.occupied_cells()]
        .into_iter()
        .enumerate()
    {
        let draw = |i: usize| {
            // Streams 4 n to 4 n + 2 belong to the points in cells.
            from[rng.below(4 * round + 3, (part << 32 | i) as u64, from.len() as u32) as usize]
        };
        let drawn: Vec<u32> = (0..from.len() / SHARE).into_par_iter().map(draw).collect();
        drawn
            .into_iter()
            // As a set of bits, cells that were drawn twice are measured once, and in ascending
            // order, which the tables' cache lines like.
            .for_each(|cell| set[cell as usize / 64] |= 1 << (cell % 64));
    }
    elements(&set)
}

fn densities(
    field: &Field,
    cells: &[u32],
    (features, scratch): &mut UpdateScratch,
    rng: &Rng,
    round: u64,
) -> Vec<f32> {
    let points = cells.iter().map(|&cell| {
        let [x, y, z, _] = rng.uniforms(4 * round, u64::from(cell));
        field.occupancy.point(cell as usize, [x, y, z])
    });
    field.look_up(points, features);
    let mut sigmas = Vec::with_capacity(cells.len());
    field.sigmas(features, 0..cells.len(), scratch, &mut sigmas);
    sigmas
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FieldConfig;
    use glam::DMat4;

    fn camera() -> Camera {
        Camera::centered((16, 12), 16.0, DMat4::IDENTITY, [1.0, 3.0])
    }

    fn field() -> Field {
        let config = FieldConfig {
            levels: 2,
            log2_table: 8,
            finest_resolution: 32,
            occupancy_resolution: 16,
            march_steps: 512,
            ..Default::default()
        };
        Field::new(&config, [[-2.0, -2.0, -4.0], [2.0, 2.0, 0.0]], 1)
    }

    #[test]
    fn only_what_is_in_view_is_seen() {
        let camera = camera();
        let sees = |camera: &Camera, center, radius| {
            sees(camera, camera.view_window(), [1.0, 3.0], center, radius)
        };
        assert!(sees(&camera, [0.0, 0.0, -2.0], 0.0));
        assert!(!sees(&camera, [0.0, 0.0, -0.5], 0.1), "before near");
        assert!(!sees(&camera, [0.0, 0.0, -3.5], 0.1), "behind far");
        assert!(
            !sees(&camera, [1.2, 0.0, -2.0], 0.1) && sees(&camera, [1.2, 0.0, -2.0], 0.3),
            "the image ends at x = 1"
        );
        assert!(
            !sees(&camera, [0.0, -0.95, -2.0], 0.1) && sees(&camera, [0.0, -0.7, -2.0], 0.0),
            "and at y = -0.75"
        );
    }

    #[test]
    fn every_point_of_every_ray_lies_in_a_seen_cell() {
        let mut field = field();
        let camera = camera();
        mark_unseen_cells(&mut field, &[&camera]);
        assert!(field.occupancy.seen_cells().len() < field.occupancy.cells());
        for i in 0..16 * 12 {
            let px = f64::from(i % 16) + 0.1;
            let py = f64::from(i / 16) + 0.9;
            for depth in [1.01, 1.7, 2.2, 2.99] {
                let point = camera.unproject(px, py, depth).map(|x| x as f32);
                let cell = field.occupancy.cell(field.space.to_unit(point));
                assert!(field.occupancy.occupied(cell), "{point:?}");
            }
        }
    }

    #[test]
    fn haze_is_occupied_with_its_own_optical_depth() {
        let mut field = field();
        let rng = Rng::new(1, "survey test");
        (0..100).for_each(|_| update(&mut field, &rng, &Pool::default()));
        assert_eq!(field.occupancy.updates, 100);
        assert_eq!(
            field.occupancy.occupied_cells().len(),
            field.occupancy.cells(),
            "an even haze"
        );
        let haze = field.occupancy.values[0];
        assert!(
            (haze - 0.367_879 / 512.0).abs() < 1e-4,
            "exp(-1) over 512 steps, not {haze}"
        );
    }
}
