//! The way back: A^T m A of neighbouring tiles of one output channel, its bias and its finish.
#![allow(unsafe_code)]

use super::super::extents::{COLUMNS, SIDE, SIGHT, SPOTS, WIDEST};
use super::super::quads::{Quads, VectorKernel};
use super::super::transform::output_transform;
use crate::ops::product::finish::Finish;

/// A^T from both sides of `count` neighbouring tiles of one output channel, then its bias and the
/// finish.
pub struct TransformOutputs<'a> {
    /// (S, P), and at least as many numbers beyond as a vector has lanes.
    pub spots: &'a [f32],
    /// The place of the first tile in the panel.
    pub at: usize,
    pub count: usize,
    pub bias: f32,
    /// What to add lies as the lines do.
    pub finish: Finish<&'a [f32]>,
    /// The lines of pixels that the row of tiles has, at most four, each `width` long.
    pub lines: &'a mut [f32],
    pub width: usize,
    /// The first tile's first pixel in its line.
    pub x: usize,
}

impl VectorKernel for TransformOutputs<'_> {
    #[inline(always)]
    unsafe fn run<V: Quads>(mut self) {
        let added = match self.finish {
            Finish::Add(other) => other.len(),
            _ => self.lines.len(),
        };
        assert!(
            self.spots.len() >= SPOTS * COLUMNS + WIDEST
                && self.at + self.count <= COLUMNS
                && self.lines.len() <= SIDE * self.width
                && added == self.lines.len(),
            "winograd: the outputs' extents disagree"
        );
        for tile in (0..self.count).step_by(V::LANES) {
            // SAFETY: by the contract of the trait, and the extents above.
            unsafe { self.tiles::<V>(tile) }
        }
    }
}

impl TransformOutputs<'_> {
    /// As many tiles as a vector has lanes, from `tile` on.
    /// SAFETY: that of [`VectorKernel::run`]; there is such a tile.
    #[inline(always)]
    unsafe fn tiles<V: Quads>(&mut self, tile: usize) {
        // SAFETY: by the contract of this function; beyond the panel's last spot there are enough
        // numbers to read.
        unsafe {
            let spots = self.spots.as_ptr().add(self.at + tile);
            let mut down = [[V::splat(0.0); SIGHT]; SIDE];
            for column in 0..SIGHT {
                let spot = |line: usize| V::load(spots.add((line * SIGHT + column) * COLUMNS));
                let values = output_transform(std::array::from_fn(spot));
                for (down, value) in down.iter_mut().zip(values) {
                    down[column] = value;
                }
            }
            let x = self.x + SIDE * tile;
            // The last tile of a line may reach beyond the image.
            let pixels = (SIDE * V::LANES).min(self.width - x);
            for (y, down) in down
                .into_iter()
                .enumerate()
                .take(self.lines.len() / self.width)
            {
                let columns = output_transform(down).map(|value| value.add(V::splat(self.bias)));
                let quad = V::to_pixels(columns);
                if pixels == SIDE * V::LANES && self.count - tile >= V::LANES {
                    self.write(quad, y * self.width + x);
                } else {
                    let pixels = pixels.min(SIDE * (self.count - tile));
                    self.write_some(quad, y * self.width + x, pixels);
                }
            }
        }
    }

    /// Finishes and stores whole vectors, from number `at` of the lines on.
    /// SAFETY: that of [`VectorKernel::run`]; the lines have room for the quad.
    #[inline(always)]
    unsafe fn write<V: Quads>(&mut self, quad: [V; SIDE], at: usize) {
        for (i, values) in quad.into_iter().enumerate() {
            let at = at + i * V::LANES;
            // SAFETY: by the contract of this function.
            unsafe {
                let values = match self.finish {
                    Finish::None => values,
                    Finish::Leaky(slope) => values.leaky(slope),
                    Finish::Add(other) => values.add(V::load(other.as_ptr().add(at))),
                };
                values.store(self.lines.as_mut_ptr().add(at));
            }
        }
    }

    /// Finishes and stores the first `pixels` of a quad, which ends beyond the image's edge.
    /// SAFETY: that of [`VectorKernel::run`].
    #[inline(always)]
    unsafe fn write_some<V: Quads>(&mut self, quad: [V; SIDE], at: usize, pixels: usize) {
        let mut all = [0.0; SIDE * WIDEST];
        for (i, values) in quad.into_iter().enumerate() {
            // SAFETY: by the contract of this function; a quad fits.
            unsafe {
                let values = match self.finish {
                    Finish::Leaky(slope) => values.leaky(slope),
                    _ => values,
                };
                values.store(all.as_mut_ptr().add(i * V::LANES));
            }
        }
        if let Finish::Add(other) = self.finish {
            for (value, other) in all.iter_mut().zip(&other[at..at + pixels]) {
                *value += other;
            }
        }
        self.lines[at..at + pixels].copy_from_slice(&all[..pixels]);
    }
}
