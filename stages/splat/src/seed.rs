//! Where splats begin: discs on the surface that depths show, one for each patch of it however many
//! cameras see it. Knows no colours.

use std::collections::BTreeSet;

use formats::Camera;
use glam::{Mat3, Quat, Vec3};
use rayon::prelude::*;

use crate::cloud::{Cloud, Splat};
use crate::harmonics::MOST;

/// A pixel with less of something in it shows no surface.
const COVERED: f32 = 0.5;
/// Neighbours whose depths differ by more than this part of them lie on different things.
const BREAK: f32 = 0.08;
/// How many points are gathered for one that is kept.
const SPARE: usize = 8;
/// By what patches grow as long as there are too many of them.
const GROWTH: f32 = 1.1;
/// The standard deviation of a disc across, in patches, and along its normal, in those.
const ACROSS: f32 = 0.5;
const ALONG: f32 = 0.1;
/// Levels of patches' widths within a factor of two.
const LEVELS: f32 = 2.0;
/// The logits of opacities that seeds may have: what is almost opaque has no gradient.
const LOGITS: [f32; 2] = [-2.0, 3.0];

/// Why there are no splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SeedError {
    /// No pixel shows a surface.
    #[error("none of the cameras sees a surface in the field")]
    Nothing,
}

/// Points of the surface, picture by picture.
pub struct Seeds {
    most: usize,
    /// Only every so many pixels a row and a column.
    stride: u32,
    points: Vec<Seed>,
}

/// A point of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seed {
    position: Vec3,
    normal: Vec3,
    /// The width of its pixel on the surface, as the camera faces it.
    footprint: f32,
    opacity: f32,
}

impl Seeds {
    /// For at most `most` splats, of pictures that have so many pixels together.
    pub fn new(most: usize, pixels: usize) -> Self {
        // More points than splats, since patches that several cameras see are thinned out.
        let room = SPARE * most.max(1);
        let mut stride = 1;
        while pixels / (stride as usize * stride as usize) > room {
            stride += 1;
        }
        Self {
            most: most.max(1),
            stride,
            points: Vec::new(),
        }
    }

    /// Adds the surface points of one view. Depth, along the view axis, and coverage are by rows.
    pub fn add_view(&mut self, camera: &Camera, depth: &[f32], coverage: &[f32]) {
        let map = DepthMap {
            camera,
            depth,
            coverage,
            stride: self.stride,
        };
        let rows = (0..camera.height.div_ceil(self.stride)).into_par_iter();
        let found: Vec<Vec<Seed>> = rows.map(|row| map.row(row * self.stride)).collect();
        self.points.extend(found.into_iter().flatten());
    }

    /// The splats: one for each patch of the surface, from the camera that sees it finest. Patches
    /// are as wide as pixels, or wider where there would be too many.
    ///
    /// # Errors
    /// If no picture shows a surface.
    pub fn cloud(mut self, degree: u32) -> Result<Cloud, SeedError> {
        if self.points.is_empty() {
            return Err(SeedError::Nothing);
        }
        // The finest first: they take their patches from coarser ones.
        self.points
            // A stable sort: equal footprints keep the order of pictures and rows.
            .sort_by(|a, b| a.footprint.total_cmp(&b.footprint));
        let mut width = self.stride as f32;
        let mut kept = thin(&self.points, width);
        // The number of patches follows from the surface, so their width is found by trying.
        while kept.len() > self.most {
            width *= GROWTH;
            kept = thin(&self.points, width);
        }
        let splats = kept.iter().map(|seed| seed.splat(width)).collect();
        Ok(Cloud { splats, degree })
    }
}

/// Which way the surface faces at each pixel, by rows: unit vectors along the world's axes, from the
/// depths of neighbours on the same thing; towards the camera where there are none, and zero where
/// nothing is covered.
pub fn normals(camera: &Camera, depth: &[f32], coverage: &[f32]) -> Vec<[f32; 3]> {
    let map = DepthMap {
        camera,
        depth,
        coverage,
        stride: 1,
    };
    let pixel = |i: u32| {
        let [x, y] = [i % camera.width, i / camera.width];
        let normal = map.normal(x, y).or_else(|| map.towards(x, y));
        normal.unwrap_or(Vec3::ZERO).to_array()
    };
    (0..camera.width * camera.height)
        .into_par_iter()
        .map(pixel)
        .collect()
}

/// A view as a depth map: camera, depth and coverage.
struct DepthMap<'s> {
    camera: &'s Camera,
    depth: &'s [f32],
    coverage: &'s [f32],
    stride: u32,
}

impl DepthMap<'_> {
    fn row(&self, y: u32) -> Vec<Seed> {
        let columns = (0..self.camera.width).step_by(self.stride as usize);
        columns.filter_map(|x| self.seed(x, y)).collect()
    }

    fn seed(&self, x: u32, y: u32) -> Option<Seed> {
        let here = self.at(x, y)?;
        let normal = self.normal(x, y)?;
        let position = self.point(x, y, here);
        // The mean of both, since a disc is round.
        let focal = 0.5 * (self.camera.fl_x + self.camera.fl_y);
        Some(Seed {
            position,
            normal,
            footprint: here / focal as f32,
            opacity: self.coverage[self.index(x, y)],
        })
    }

    /// The way from the surface to the camera.
    fn towards(&self, x: u32, y: u32) -> Option<Vec3> {
        let position = self.point(x, y, self.at(x, y)?);
        Some((self.camera.position().as_vec3() - position).normalize_or(Vec3::Z))
    }

    /// Which way the surface faces; `None` where it cannot be said.
    fn normal(&self, x: u32, y: u32) -> Option<Vec3> {
        let towards = self.towards(x, y)?;
        let across = self.slope(x, y, [1, 0])?;
        let down = self.slope(x, y, [0, 1])?;
        // In this order the product points to the camera: rows go down.
        let normal = down.cross(across).normalize_or(towards);
        // A surface seen so much from the side that it seems to turn away is faced instead.
        Some(if normal.dot(towards) > 0.05 {
            normal
        } else {
            towards
        })
    }

    /// The way along the surface from one neighbour to the other; `None` between two things, where
    /// depths are mixed. At a rim it is the way to the only neighbour on the same thing.
    fn slope(&self, x: u32, y: u32, [right, down]: [u32; 2]) -> Option<Vec3> {
        let here = self.at(x, y)?;
        let before = x.checked_sub(right).zip(y.checked_sub(down));
        let before = before.and_then(|(x, y)| Some((x, y, self.at(x, y)?)));
        let after = (x + right, y + down);
        let after = self
            .at(after.0, after.1)
            .map(|depth| (after.0, after.1, depth));
        let is_near = |depth: f32| (depth - here).abs() < BREAK * here;
        let [before, after] = [before, after].map(|side| side.filter(|side| is_near(side.2)));
        let point = |(x, y, depth)| self.point(x, y, depth);
        match (before, after) {
            (Some(before), Some(after)) => Some(point(after) - point(before)),
            (Some(before), None) => Some(self.point(x, y, here) - point(before)),
            (None, Some(after)) => Some(point(after) - self.point(x, y, here)),
            (None, None) => None,
        }
    }

    fn point(&self, x: u32, y: u32, depth: f32) -> Vec3 {
        let [px, py] = [x, y].map(|pixel| f64::from(pixel) + 0.5);
        let point = self.camera.unproject(px, py, f64::from(depth));
        Vec3::from(point.map(|axis| axis as f32))
    }

    /// The depth of a pixel that shows a surface.
    fn at(&self, x: u32, y: u32) -> Option<f32> {
        let inside = x < self.camera.width && y < self.camera.height;
        let depth = inside.then(|| self.depth[self.index(x, y)])?;
        (self.coverage[self.index(x, y)] > COVERED && depth.is_finite()).then_some(depth)
    }

    fn index(&self, x: u32, y: u32) -> usize {
        y as usize * self.camera.width as usize + x as usize
    }
}

impl Seed {
    fn splat(&self, width: f32) -> Splat {
        let across = (ACROSS * width * self.footprint).ln();
        // 0 and 1 have no logit.
        let opacity = self.opacity.clamp(0.01, 0.99);
        Splat {
            position: self.position,
            rotation: facing(self.normal),
            log_scale: Vec3::new(across, across, across + ALONG.ln()),
            logit: (opacity / (1.0 - opacity)).ln().clamp(LOGITS[0], LOGITS[1]),
            harmonics: [[0.0; 3]; MOST],
        }
    }
}

/// A rotation that turns the third axis into the normal.
fn facing(normal: Vec3) -> Quat {
    let (across, up) = normal.any_orthonormal_pair();
    Quat::from_mat3(&Mat3::from_cols(across, up, normal)).normalize()
}

/// A cell of a grid of some level; its sides double within [`LEVELS`].
type Cell = (i32, [i32; 3]);

/// One point for each patch, from the finest on: a cell that a finer point lies in is taken.
fn thin(points: &[Seed], width: f32) -> Vec<Seed> {
    let Some(coarsest) = points.last().map(|last| level(last, width)) else {
        return Vec::new();
    };
    // A sorted set, whose behaviour does not depend on random hash keys.
    let mut taken: BTreeSet<Cell> = BTreeSet::new();
    let mut kept = Vec::new();
    for point in points {
        let own = level(point, width);
        if taken.insert(cell(point, own)) {
            // Coarser points near by see the same patch.
            taken.extend((own + 1..=coarsest).map(|level| cell(point, level)));
            kept.push(*point);
        }
    }
    kept
}

/// The level at which cells are about as wide as a point's patch.
fn level(point: &Seed, width: f32) -> i32 {
    // Logarithms of widths, so that a level is a factor and not a distance.
    (LEVELS * (point.footprint * width).log2()).round() as i32
}

/// The cell of a level that a point lies in.
fn cell(point: &Seed, level: i32) -> Cell {
    let side = (level as f32 / LEVELS).exp2();
    (level, (point.position / side).floor().as_ivec3().to_array())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat4, DVec3};

    /// A wall at z = 0, seen from 4 in front of it by cameras beside each other.
    fn wall(most: usize) -> Cloud {
        let mut seeds = Seeds::new(most, 3 * 40 * 30);
        for i in 0..3 {
            let place = DVec3::new(0.05 * f64::from(i), 0.0, 4.0);
            let pose = DMat4::from_translation(place);
            let camera = Camera::centered((40, 30), 50.0, pose, [1.0, 9.0]);
            seeds.add_view(&camera, &[4.0; 1200], &[1.0; 1200]);
        }
        seeds.cloud(0).unwrap()
    }

    #[test]
    fn a_wall_that_three_cameras_see_is_covered_once_by_discs_that_face_them() {
        let cloud = wall(2000);
        let count = cloud.splats.len();
        assert!((900..1700).contains(&count), "{count} for 1200 pixels");
        for splat in &cloud.splats {
            assert!(splat.position.z.abs() < 1e-5, "{splat:?}");
            assert!(splat.axes()[2].dot(Vec3::Z) > 0.999, "{splat:?}");
            let [across, along] = [splat.scale().x, splat.scale().z];
            assert!((across - 0.04).abs() < 1e-3 && (along - 0.004).abs() < 1e-4);
        }
    }

    #[test]
    fn there_are_never_more_than_asked_for() {
        let count = wall(200).splats.len();
        assert!((100..=200).contains(&count), "{count}");
    }

    #[test]
    fn nothing_gives_no_splats() {
        let seeds = Seeds::new(10, 100);
        assert_eq!(seeds.cloud(0), Err(SeedError::Nothing));
    }
}
