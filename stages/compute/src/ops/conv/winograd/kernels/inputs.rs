//! The way in: B^T x B of neighbouring tiles of one channel.
#![allow(unsafe_code)]

use super::super::extents::{COLUMNS, SEEN, SIDE, SIGHT, SPOTS, WIDEST};
use super::super::quads::{Quads, VectorKernel};
use super::super::transform::input_transform;
use crate::runtime::cpu::matrix::MatrixMut;

/// Pixels of a line in scratch space: those that tiles see, and what the last vector writes beyond
/// them; whole cache lines.
const LINE: usize = (SEEN + WIDEST).next_multiple_of(16);

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
    /// Scratch space between the transform down the lines and the one along them.
    pub lines: &'a mut Lines,
    /// (S, P): the tiles' numbers at each spot.
    pub spots: MatrixMut<'a>,
    /// The place of the first tile in the panel.
    pub at: usize,
    pub count: usize,
}

impl VectorKernel for TransformInputs<'_> {
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
    /// Down the six lines first: neighbouring tiles share what they both see, and pixels need not
    /// be sorted by column yet. B^T of zeros is zero, so padding is filled in afterwards. SAFETY:
    /// that of [`VectorKernel::run`]; the lines have room.
    #[inline(always)]
    unsafe fn transform_down<V: Quads>(&mut self) {
        let zeros = self.zeros;
        let len = self.source[0].len();
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

    /// Along the lines, whose pixels are sorted by their column in the tile: then a vector is one
    /// number of many tiles.
    /// SAFETY: that of [`VectorKernel::run`]; the panel has room for the tiles.
    #[inline(always)]
    unsafe fn transform_along<V: Quads>(&mut self) {
        let stride = self.spots.row_stride();
        let spots = self.spots.start();
        for tile in (0..self.count).step_by(V::LANES) {
            for (line, pixels) in self.lines.0.iter().enumerate() {
                // SAFETY: by the contract of this function; a line has room for the tiles of a
                // whole panel.
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
/// SAFETY: that of [`VectorKernel::run`]; `to` has room for so many.
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
