//! Which splats are drawn in which square of an image, from front to back. Knows no colours.

use formats::Camera;
use glam::Vec2;
use rayon::prelude::*;

use crate::cloud::Cloud;
use crate::project::{Ellipse, Eye};

/// Pixels along a square's side.
// 16 pixels as in Kerbl et al.: smaller squares repeat splats in more lists.
pub const SIDE: u32 = 16;

/// The splats that a camera sees, and where.
pub struct Tiles {
    /// Each splat in the image, if it is there.
    pub ellipses: Vec<Option<Ellipse>>,
    /// By square, row by row: its splats from front to back.
    pub lists: Vec<Vec<u32>>,
    width: u32,
    height: u32,
}

/// A square of an image.
#[derive(Clone, Copy, Debug)]
pub struct Tile {
    pub left: u32,
    pub top: u32,
    pub right: u32,
    pub bottom: u32,
}

impl Tile {
    /// The pixels' numbers in the image, by rows.
    pub fn pixels(self, width: u32) -> impl Iterator<Item = (usize, Vec2)> {
        let rows = self.top..self.bottom;
        rows.flat_map(move |y| {
            (self.left..self.right).map(move |x| {
                let index = y as usize * width as usize + x as usize;
                (index, Vec2::new(x as f32 + 0.5, y as f32 + 0.5))
            })
        })
    }
}

impl Tiles {
    /// Of a cloud and a camera.
    pub fn new(cloud: &Cloud, camera: &Camera) -> Self {
        let eye = Eye::new(camera);
        let coefficients = cloud.coefficients();
        let project = |splat| eye.project(splat, coefficients);
        let ellipses: Vec<Option<Ellipse>> = cloud.splats.par_iter().map(project).collect();
        let mut tiles = Self {
            ellipses,
            lists: Vec::new(),
            width: camera.width,
            height: camera.height,
        };
        tiles.lists = tiles.sorted();
        tiles
    }

    fn columns(&self) -> u32 {
        self.width.div_ceil(SIDE)
    }

    /// The square of this number.
    pub fn tile(&self, index: usize) -> Tile {
        let left = index as u32 % self.columns() * SIDE;
        let top = index as u32 / self.columns() * SIDE;
        Tile {
            left,
            top,
            right: self.width.min(left + SIDE),
            bottom: self.height.min(top + SIDE),
        }
    }

    fn sorted(&self) -> Vec<Vec<u32>> {
        let seen = self.ellipses.iter().enumerate();
        let mut order: Vec<(f32, u32)> = seen
            .filter_map(|(i, ellipse)| Some((ellipse.as_ref()?.depth, i as u32)))
            .collect();
        // Of two at one depth the first in the cloud is in front.
        // By a full order of depth and number, so that an unstable parallel sort gives one result.
        order.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let rows = self.height.div_ceil(SIDE);
        let mut lists = vec![Vec::new(); (self.columns() * rows) as usize];
        // Pushed in order of depth, so that every list is sorted without a sort of its own.
        for (_, splat) in order {
            let Some(ellipse) = &self.ellipses[splat as usize] else {
                continue;
            };
            let [xs, ys] = [0, 1].map(|axis| {
                let end = if axis == 0 { self.columns() } else { rows };
                span(ellipse.center[axis], ellipse.reach[axis], end)
            });
            for y in ys {
                for x in xs.clone() {
                    lists[(y * self.columns() + x) as usize].push(splat);
                }
            }
        }
        lists
    }
}

/// The squares along an axis that an ellipse reaches.
fn span(center: f32, reach: f32, end: u32) -> std::ops::Range<u32> {
    let side = SIDE as f32;
    let first = ((center - reach) / side).floor().max(0.0);
    let last = ((center + reach) / side).ceil().min(end as f32);
    // What lies beside the image has an empty range.
    first as u32..(last.max(0.0) as u32)
}
