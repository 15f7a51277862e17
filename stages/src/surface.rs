//! The surface of a field at one density, as a mesh, by surface nets (Gibson 1998): each cell that
//! the surface crosses has one vertex, the mean of the crossings of its edges, and each crossed
//! edge joins the vertices of the four cells around it. Unlike marching cubes that needs no table
//! of cases, and leaves no slivers. Knows nothing of files.

use std::f32::consts::LN_2;

use nerf::Field;
use rayon::prelude::*;

/// A surface in world space.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// One for each cell of the grid that it crosses.
    pub vertices: Vec<Vertex>,
    /// Triangles, counter-clockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// A point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// In the scene's coordinates.
    pub position: [f32; 3],
    /// The unit normal, outwards.
    pub normal: [f32; 3],
    /// Its colour as seen along the normal, sRGB-encoded from 0 to 1.
    pub color: [f32; 3],
}

impl Vertex {
    /// Its colour in 8 bits.
    pub fn bytes(&self) -> [u8; 3] {
        self.color
            .map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8)
    }
}

/// Cells along the box's longest side that show what a field of the usual size knows.
pub const USUAL_RESOLUTION: u32 = 192;
/// The corners of a cell and the pairs of them that are its edges: bit 0 is x, bit 1 is y, bit 2 is
/// z.
const EDGES: [(usize, usize); 12] = [
    (0, 1),
    (2, 3),
    (4, 5),
    (6, 7),
    (0, 2),
    (1, 3),
    (4, 6),
    (5, 7),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
];
/// Densities below are as good as none; the logarithm wants a bound.
const NOTHING: f32 = 1e-6;
/// Points per request to the field; fixed, to bound the memory of a task.
const CHUNK: usize = 4096;

/// A grid of values at points, x fastest.
struct Grid {
    size: [usize; 3],
    low: [f32; 3],
    step: f32,
    values: Vec<f32>,
}

impl Grid {
    fn place(&self, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [index % nx, index / nx % ny, index / (nx * ny)]
    }

    fn point(&self, at: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| self.low[axis] + self.step * at[axis])
    }

    /// The values at the eight corners of the cell whose lowest corner has this index.
    fn corners(&self, lowest: usize) -> [f32; 8] {
        let [nx, ny, _] = self.size;
        std::array::from_fn(|i| {
            self.values[lowest + (i & 1) + (i >> 1 & 1) * nx + (i >> 2) * nx * ny]
        })
    }
}

/// The density at which half of the light is lost within a hundredth of the box's longest side.
pub fn usual_level(field: &Field) -> f32 {
    // From exp(-level x) = 1/2 at x = 0.01 of that side.
    LN_2 / (0.01 * longest_side(field))
}

fn longest_side(field: &Field) -> f32 {
    let [low, high] = field.bounds();
    (0..3)
        .map(|axis| high[axis] - low[axis])
        .fold(0.0, f32::max)
}

/// The surface on which the field's density is `level` (per world length), on a grid with
/// `resolution` cells along the box's longest side. The same field gives the same surface for any
/// number of threads.
pub fn surface(field: &Field, resolution: u32, level: f32) -> Surface {
    let grid = sample(field, resolution, level);
    let (places, owners) = vertices(&grid);
    let triangles = triangles(&grid, &owners);
    let colors: Vec<[f32; 3]> = places
        .par_chunks(CHUNK)
        .flat_map_iter(|places| {
            let points: Vec<_> = places.iter().map(|(position, _)| *position).collect();
            let inwards: Vec<_> = places
                .iter()
                .map(|(_, normal)| normal.map(|part| -part))
                .collect();
            // A camera that looks at a surface looks against its normal.
            field.colors(&points, &inwards)
        })
        .collect();
    let vertex = |((position, normal), color)| Vertex {
        position,
        normal,
        color,
    };
    Surface {
        vertices: places.into_iter().zip(colors).map(vertex).collect(),
        triangles,
    }
}

/// Logarithms of the density over the level: positive inside. They change more evenly through a
/// surface than densities do. A rim of nothing around the box closes what the box cuts.
fn sample(field: &Field, resolution: u32, level: f32) -> Grid {
    let [low, high] = field.bounds();
    let step = longest_side(field) / resolution as f32;
    // One point more than cells, and one of the rim at each end.
    let size = [0, 1, 2].map(|axis| ((high[axis] - low[axis]) / step).ceil() as usize + 3);
    // Half a step out: the first points lie beyond the box, where a field has nothing.
    let low = low.map(|corner| corner - 0.5 * step);
    let mut grid = Grid {
        size,
        low,
        step,
        values: Vec::new(),
    };
    let count = size.iter().product::<usize>();
    let chunk = |chunk: usize| {
        let range = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
        let points: Vec<_> = range
            .map(|i| grid.point(grid.place(i).map(|part| part as f32)))
            .collect();
        field
            .visible_densities(&points)
            .into_iter()
            .map(|density| (density.max(NOTHING) / level).ln())
            .collect::<Vec<_>>()
    };
    grid.values = (0..count.div_ceil(CHUNK))
        .into_par_iter()
        .flat_map_iter(chunk)
        .collect();
    grid
}

/// A position and a normal for each crossed cell, and for each cell the number of its vertex.
type Vertices = (Vec<([f32; 3], [f32; 3])>, Vec<u32>);

fn vertices(grid: &Grid) -> Vertices {
    let mut owners = vec![u32::MAX; grid.values.len()];
    let mut found = Vec::new();
    // In one thread and in the grid's order: vertices have the same numbers however many threads
    // there are.
    for (index, owner) in owners.iter_mut().enumerate() {
        let place = grid.place(index);
        // The last points of an axis begin no cell.
        if (0..3).any(|axis| place[axis] + 1 == grid.size[axis]) {
            continue;
        }
        let corners = grid.corners(index);
        if let Some(inside) = crossing(&corners) {
            *owner = found.len() as u32;
            let at = std::array::from_fn(|axis| place[axis] as f32 + inside[axis]);
            found.push((grid.point(at), outwards(&corners)));
        }
    }
    (found, owners)
}

/// The mean of the points at which the edges of a cell are crossed, in the cell; `None` if none is.
fn crossing(corners: &[f32; 8]) -> Option<[f32; 3]> {
    let mut sum = [0.0; 3];
    let mut count = 0;
    for (a, b) in EDGES {
        if (corners[a] > 0.0) != (corners[b] > 0.0) {
            // The signs differ, so the difference is never 0.
            let part = corners[a] / (corners[a] - corners[b]);
            for (axis, sum) in sum.iter_mut().enumerate() {
                let [from, to] = [a, b].map(|corner| (corner >> axis & 1) as f32);
                *sum += from + part * (to - from);
            }
            count += 1;
        }
    }
    (count > 0).then(|| sum.map(|sum| sum / count as f32))
}

/// The direction in which a cell's values fall.
fn outwards(corners: &[f32; 8]) -> [f32; 3] {
    let fall = |axis: usize| -> f32 {
        (0..8)
            .map(|i| {
                if i >> axis & 1 == 0 {
                    corners[i]
                } else {
                    -corners[i]
                }
            })
            .sum()
    };
    let fall = [fall(0), fall(1), fall(2)];
    let length = fall.iter().map(|part| part * part).sum::<f32>().sqrt();
    if length > 0.0 {
        fall.map(|part| part / length)
    } else {
        // A cell whose corners balance has no direction; any unit vector will do.
        [0.0, 0.0, 1.0]
    }
}

/// Two triangles for each crossed edge of the grid, between the vertices of the four cells around
/// it.
fn triangles(grid: &Grid, owners: &[u32]) -> Vec<[u32; 3]> {
    let strides = [1, grid.size[0], grid.size[0] * grid.size[1]];
    let mut triangles = Vec::new();
    for index in 0..grid.values.len() {
        let place = grid.place(index);
        for axis in 0..3 {
            let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
            if place[axis] + 1 == grid.size[axis] || place[u] == 0 || place[v] == 0 {
                continue;
            }
            let here = grid.values[index] > 0.0;
            let there = grid.values[index + strides[axis]] > 0.0;
            let around = [0, strides[u], strides[u] + strides[v], strides[v]]
                .map(|back| owners[index - back]);
            if here == there || around.contains(&u32::MAX) {
                continue;
            }
            let [a, b, c, d] = around;
            // As seen from the end of the axis the cells run a, b, c, d counter-clockwise: outside
            // if inside is here.
            let faces = if here {
                [[a, b, c], [a, c, d]]
            } else {
                [[a, c, b], [a, d, c]]
            };
            triangles.extend(faces);
        }
    }
    triangles
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball of radius 0.3 around the middle of a unit cube.
    fn ball() -> Grid {
        let size = [24, 25, 26];
        let mut grid = Grid {
            size,
            low: [0.0; 3],
            step: 1.0 / 24.0,
            values: Vec::new(),
        };
        let distance = |p: [f32; 3]| p.iter().map(|x| (x - 0.5) * (x - 0.5)).sum::<f32>().sqrt();
        let value = |i| 0.3 - distance(grid.point(grid.place(i).map(|part| part as f32)));
        grid.values = (0..size.iter().product()).map(value).collect();
        grid
    }

    fn cross([a, b, c]: [f32; 3], [d, e, f]: [f32; 3]) -> [f32; 3] {
        [b * f - c * e, c * d - a * f, a * e - b * d]
    }

    #[test]
    fn a_ball_has_its_radius_its_normals_and_its_volume() {
        let grid = ball();
        let (vertices, owners) = vertices(&grid);
        for (position, normal) in &vertices {
            let out = position.map(|x| x - 0.5);
            let radius = out.iter().map(|x| x * x).sum::<f32>().sqrt();
            let cosine: f32 = out.iter().zip(normal).map(|(a, b)| a * b).sum::<f32>() / radius;
            assert!(
                (radius - 0.3).abs() < 0.01 && cosine > 0.98,
                "{position:?} {normal:?}"
            );
        }
        // By the divergence theorem: the volume is the sum of a . (b x c) / 6 over triangles that
        // face outwards.
        let corner = |i: u32| vertices[i as usize].0;
        let volume: f32 = triangles(&grid, &owners)
            .iter()
            .map(|[a, b, c]| {
                let normal = cross(corner(*b), corner(*c));
                corner(*a)
                    .iter()
                    .zip(normal)
                    .map(|(a, n)| a * n)
                    .sum::<f32>()
                    / 6.0
            })
            .sum();
        assert!((volume / 0.1131 - 1.0).abs() < 0.03, "{volume}");
    }

    #[test]
    fn a_closed_surface_has_every_edge_twice_once_each_way() {
        let grid = ball();
        let (_, owners) = vertices(&grid);
        let mut edges: Vec<[u32; 2]> = triangles(&grid, &owners)
            .iter()
            .flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]])
            .collect();
        edges.sort_unstable();
        assert!(
            edges.windows(2).all(|pair| pair[0] != pair[1]),
            "no edge twice the same way"
        );
        assert!(
            edges
                .iter()
                .all(|[a, b]| edges.binary_search(&[*b, *a]).is_ok()),
            "each comes back"
        );
    }
}
