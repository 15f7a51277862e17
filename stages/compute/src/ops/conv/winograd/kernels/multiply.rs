//! The products at one spot: a matrix of kernels times one of tiles, in tiles of sums that stay in
//! registers.
#![allow(unsafe_code)]

use super::super::extents::{BLOCK, COLUMNS, DEPTH};
use super::super::quads::{Quads, VectorKernel};
use crate::ops::product::cpu::tile::Old;
use crate::runtime::cpu::matrix::MatrixMut;

/// Terms that are summed one after the other before they join the total, as in every other product
/// (`tile`).
const CHAIN: usize = 32;

/// The products at one spot: `sums[r][p] (+)= sum over c of kernels[c][r] tiles[c][p]`.
pub struct Multiply<'a> {
    /// (C, R), C at most [`DEPTH`].
    pub kernels: &'a [f32],
    /// (C, P), P the tiles of a panel.
    pub tiles: &'a [f32],
    /// (R, P), or fewer rows.
    pub sums: MatrixMut<'a>,
    pub old: Old,
}

impl VectorKernel for Multiply<'_> {
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
    /// SAFETY: that of [`VectorKernel::run`]; the tile lies within the extents.
    #[inline(always)]
    unsafe fn tile<V: Quads, const N: usize>(&mut self, depth: usize, row: usize, column: usize) {
        let stride = self.sums.row_stride();
        // SAFETY: by the contract of this function.
        unsafe {
            let kernels = self.kernels.as_ptr().add(row);
            let tiles = self.tiles.as_ptr().add(column);
            let out = self.sums.start().add(row * stride + column);
            // Short chains round less than one long chain, and the compiler keeps both in
            // registers.
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
