//! The innermost loops: transforms of as many tiles, or kernels, at a time as a vector has lanes, and the products at
//! one spot. They know where numbers lie, not which part of an image they are.
//!
//! Shapes: P = [`COLUMNS`] tiles of a panel, R = [`BLOCK`] outputs of a block, S = [`SPOTS`], C channels.
#![allow(unsafe_code)]

use super::quads::{Kernel, Quads};
use super::transform::{SIDE, SIGHT, SPOTS, input_transform, kernel_transform, output_transform};
use crate::conv::Finish;
use crate::cpu::matrix::MatrixMut;
use crate::cpu::tile::{COLUMNS, Old};

/// Outputs whose kernels are packed side by side: a cache line of them.
pub const BLOCK: usize = 16;
/// The most lanes of a vector.
const WIDEST: usize = 16;
/// Pixels of a line that the tiles of a panel see.
pub const SEEN: usize = SIDE * COLUMNS + SIGHT - SIDE;
/// Pixels of a line in scratch space: those, and what the last vector writes beyond them; whole cache lines.
const LINE: usize = (SEEN + WIDEST).next_multiple_of(16);
/// Terms that are summed one after the other before they join the total, as in every other product (`tile`).
const CHAIN: usize = 32;
/// Terms after which the total joins what the result holds; with [`CHAIN`] it decides the order of the sum, and so its
/// bits.
pub const DEPTH: usize = 128;

/// Scratch space for the six lines of pixels that a row of tiles sees.
#[repr(align(64))]
pub struct Lines([[f32; LINE]; SIGHT]);

impl Lines {
    pub fn new() -> Lines {
        Lines([[0.0; LINE]; SIGHT])
    }
}

/// B^T from both sides of `count` neighbouring tiles of one channel.
pub struct TransformInputs<'a> {
    /// The six lines that the tiles see, as far as they lie in the image: equally long.
    pub source: [&'a [f32]; SIGHT],
    /// Zeros before them, which the first tile sees.
    pub zeros: usize,
    /// Space.
    pub lines: &'a mut Lines,
    /// (S, P): the tiles' numbers at each spot.
    pub spots: MatrixMut<'a>,
    /// The place of the first tile in the panel.
    pub at: usize,
    pub count: usize,
}

impl Kernel for TransformInputs<'_> {
    #[inline(always)]
    unsafe fn run<V: Quads>(mut self) {
        assert!(
            self.zeros + self.source[0].len() <= SEEN
                && self
                    .source
                    .iter()
                    .all(|line| line.len() == self.source[0].len())
                && self.spots.rows() == SPOTS
                && self.spots.columns() == COLUMNS
                && self.at + self.count <= COLUMNS,
            "winograd: the inputs' extents disagree"
        );
        // SAFETY: by the contract of the trait, and the extents above.
        unsafe {
            self.transform_down::<V>();
            self.transform_along::<V>();
        }
    }
}

impl TransformInputs<'_> {
    /// Down the six lines first: neighbouring tiles share what they both see, and pixels need not be sorted by column
    /// yet. B^T of zeros is zero, so padding is filled in afterwards.
    /// SAFETY: that of [`Kernel::run`]; the lines have room.
    #[inline(always)]
    unsafe fn transform_down<V: Quads>(&mut self) {
        let (len, zeros) = (self.source[0].len(), self.zeros);
        // Fewer pixels than lanes are read from a copy that is long enough.
        let mut few = [[0.0; WIDEST]; SIGHT];
        if len < V::LANES {
            for (few, line) in few.iter_mut().zip(self.source) {
                few[..len].copy_from_slice(line);
            }
        }
        let from: [*const f32; SIGHT] = std::array::from_fn(|line| {
            if len < V::LANES {
                few[line].as_ptr()
            } else {
                self.source[line].as_ptr()
            }
        });
        let last = len.saturating_sub(V::LANES);
        for start in (0..len).step_by(V::LANES) {
            // The last vector ends where the line does, and repeats some of the one before it.
            let x = start.min(last);
            // SAFETY: by the contract of this function; `x` leaves a whole vector.
            unsafe {
                let down = input_transform(from.map(|line| V::load(line.add(x))));
                for (line, down) in self.lines.0.iter_mut().zip(down) {
                    down.store(line.as_mut_ptr().add(zeros + x));
                }
            }
        }
        for line in &mut self.lines.0 {
            line[..zeros].fill(0.0);
            line[zeros + len..SIDE * self.count + SIGHT - SIDE].fill(0.0);
        }
    }

    /// Along the lines, whose pixels are sorted by their column in the tile: then a vector is one number of many tiles.
    /// SAFETY: that of [`Kernel::run`]; the panel has room for the tiles.
    #[inline(always)]
    unsafe fn transform_along<V: Quads>(&mut self) {
        let stride = self.spots.row_stride();
        let spots = self.spots.start();
        for tile in (0..self.count).step_by(V::LANES) {
            for (line, pixels) in self.lines.0.iter().enumerate() {
                // SAFETY: by the contract of this function; a line has room for the tiles of a whole panel.
                unsafe {
                    let from = pixels.as_ptr().add(SIDE * tile);
                    let quad = std::array::from_fn(|i| V::load(from.add(i * V::LANES)));
                    let [a, b, c, d] = V::to_columns(quad);
                    let e = a.followed_by(*from.add(SIDE * V::LANES));
                    let f = b.followed_by(*from.add(SIDE * V::LANES + 1));
                    let along = input_transform([a, b, c, d, e, f]);
                    for (column, value) in along.into_iter().enumerate() {
                        let to = spots.add((line * SIGHT + column) * stride + self.at + tile);
                        store_first(value, self.count - tile, to);
                    }
                }
            }
        }
    }
}

/// Stores the first `count` lanes, or all if there are no more.
/// SAFETY: that of [`Kernel::run`]; `to` has room for so many.
#[inline(always)]
unsafe fn store_first<V: Quads>(values: V, count: usize, to: *mut f32) {
    // SAFETY: by the contract of this function.
    unsafe {
        if count >= V::LANES {
            return values.store(to);
        }
        let mut all = [0.0; WIDEST];
        values.store(all.as_mut_ptr());
        std::ptr::copy_nonoverlapping(all.as_ptr(), to, count);
    }
}

/// The products at one spot: `sums[r][p] (+)= sum over c of kernels[c][r] tiles[c][p]`.
pub struct Multiply<'a> {
    /// (C, R), C at most [`DEPTH`].
    pub kernels: &'a [f32],
    /// (C, P).
    pub tiles: &'a [f32],
    /// (R, P), or fewer rows.
    pub sums: MatrixMut<'a>,
    pub old: Old,
}

impl Kernel for Multiply<'_> {
    #[inline(always)]
    unsafe fn run<V: Quads>(mut self) {
        let depth = self.kernels.len() / BLOCK;
        assert!(
            depth <= DEPTH
                && self.tiles.len() >= depth * COLUMNS
                && self.sums.rows().is_multiple_of(8)
                && self.sums.rows() <= BLOCK
                && self.sums.columns() == COLUMNS,
            "winograd: the products' extents disagree"
        );
        for row in (0..self.sums.rows()).step_by(8) {
            for column in (0..COLUMNS).step_by(2 * V::LANES) {
                // SAFETY: by the contract of the trait, and the extents above.
                unsafe {
                    // Eight rows of two vectors fill half of 32 registers, four rows half of 16.
                    if V::TALL > 8 {
                        self.tile::<V, 8>(depth, row, column);
                    } else {
                        self.tile::<V, 4>(depth, row, column);
                        self.tile::<V, 4>(depth, row + 4, column);
                    }
                }
            }
        }
    }
}

impl Multiply<'_> {
    /// `N` rows of two vectors.
    /// SAFETY: that of [`Kernel::run`]; the tile lies within the extents.
    #[inline(always)]
    unsafe fn tile<V: Quads, const N: usize>(&mut self, depth: usize, row: usize, column: usize) {
        let stride = self.sums.row_stride();
        // SAFETY: by the contract of this function.
        unsafe {
            let kernels = self.kernels.as_ptr().add(row);
            let tiles = self.tiles.as_ptr().add(column);
            let out = self.sums.start().add(row * stride + column);
            let mut totals = [[V::splat(0.0); 2]; N];
            for first in (0..depth).step_by(CHAIN) {
                let mut sums = [[V::splat(0.0); 2]; N];
                for c in first..depth.min(first + CHAIN) {
                    let tiles = tiles.add(c * COLUMNS);
                    let kernels = kernels.add(c * BLOCK);
                    let b = [V::load(tiles), V::load(tiles.add(V::LANES))];
                    for (r, sums) in sums.iter_mut().enumerate() {
                        let a = V::splat(*kernels.add(r));
                        sums[0] = a.multiply_add(b[0], sums[0]);
                        sums[1] = a.multiply_add(b[1], sums[1]);
                    }
                }
                for (totals, sums) in totals.iter_mut().zip(&sums) {
                    *totals = [totals[0].add(sums[0]), totals[1].add(sums[1])];
                }
            }
            for (r, totals) in totals.iter().enumerate() {
                for (i, total) in totals.iter().enumerate() {
                    let out = out.add(r * stride + i * V::LANES);
                    match self.old {
                        Old::Forget => total.store(out),
                        Old::Keep => total.add(V::load(out)).store(out),
                    }
                }
            }
        }
    }
}

/// A^T from both sides of `count` neighbouring tiles of one output channel, then its bias and the finish.
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

impl Kernel for TransformOutputs<'_> {
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
    /// SAFETY: that of [`Kernel::run`]; there is such a tile.
    #[inline(always)]
    unsafe fn tiles<V: Quads>(&mut self, tile: usize) {
        // SAFETY: by the contract of this function; beyond the panel's last spot there are enough numbers to read.
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
    /// SAFETY: that of [`Kernel::run`]; the lines have room for the quad.
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

    /// The same of the first `pixels` only: at the image's edge.
    /// SAFETY: that of [`Kernel::run`].
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

/// G from both sides of the kernels of a block of outputs and some channels.
pub struct TransformTaps<'a> {
    /// (C, 9, R), of these channels.
    pub taps: &'a [f32],
    /// Whether the taps are used in reverse.
    pub reverse: bool,
    /// (S, C, R), of all channels.
    pub spots: &'a mut [f32],
    /// The first of these channels among all.
    pub first: usize,
    pub channels: usize,
}

impl Kernel for TransformTaps<'_> {
    #[inline(always)]
    unsafe fn run<V: Quads>(mut self) {
        let count = self.taps.len() / (9 * BLOCK);
        assert!(
            self.first + count <= self.channels
                && self.spots.len() == SPOTS * self.channels * BLOCK,
            "winograd: the kernels' extents disagree"
        );
        for channel in 0..count {
            for lane in (0..BLOCK).step_by(V::LANES) {
                // SAFETY: by the contract of the trait, and the extents above.
                unsafe { self.channel::<V>(channel, lane) }
            }
        }
    }
}

impl TransformTaps<'_> {
    /// As many outputs as a vector has lanes, from `lane` on.
    /// SAFETY: that of [`Kernel::run`]; the channel is one of these.
    #[inline(always)]
    unsafe fn channel<V: Quads>(&mut self, channel: usize, lane: usize) {
        // SAFETY: by the contract of this function.
        unsafe {
            let taps = self.taps.as_ptr().add(channel * 9 * BLOCK + lane);
            let tap = |row: usize, column: usize| {
                let forward = 3 * row + column;
                let tap = if self.reverse { 8 - forward } else { forward };
                V::load(taps.add(tap * BLOCK))
            };
            let down: [[V; SIGHT]; 3] = std::array::from_fn(|column| {
                kernel_transform(std::array::from_fn(|row| tap(row, column)))
            });
            for line in 0..SIGHT {
                let row = std::array::from_fn(|column| down[column][line]);
                for (column, value) in kernel_transform(row).into_iter().enumerate() {
                    let place = (line * SIGHT + column) * self.channels + self.first + channel;
                    value.store(self.spots.as_mut_ptr().add(place * BLOCK + lane));
                }
            }
        }
    }
}
