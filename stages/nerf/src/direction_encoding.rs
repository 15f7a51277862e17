//! The directions that samples are seen along, encoded as spherical harmonics, and what they add to
//! the colour network's first hidden layer. Knows nothing of the rows' positions.

use crate::kernels::matrix::{Epilogue, Matrix, Prologue, ROWS, add_transposed_product, product};
use crate::network::HIDDEN;
use crate::spherical::{COEFFICIENTS, harmonics};
use std::ops::Range;

/// The view directions of some rows. A ray's samples share one direction, so that the colour
/// network's product with it is made once for all of them.
#[derive(Default)]
pub struct DirectionEncoding {
    rows: Vec<Range<usize>>,
    /// [direction][[`COEFFICIENTS`]]: spherical harmonics, and rows of zeros until tiles are whole.
    harmonics: Vec<f32>,
    /// [direction][[`HIDDEN`]]: what each adds to the first hidden layer, or the sum of the gradients
    /// to it.
    hidden: Vec<f32>,
}

impl DirectionEncoding {
    /// Says which rows are seen along which unit direction. Ranges follow each other.
    pub fn set(&mut self, directions: impl Iterator<Item = ([f32; 3], Range<usize>)>) {
        self.rows.clear();
        self.harmonics.clear();
        for (direction, range) in directions {
            self.rows.push(range);
            self.harmonics.extend(harmonics(direction));
        }
        let padded = self.rows.len().next_multiple_of(ROWS);
        self.harmonics.resize(padded * COEFFICIENTS, 0.0);
        self.hidden.resize(padded * HIDDEN, 0.0);
    }

    /// Writes what each direction adds to its rows of the first hidden layer, through `weights`
    /// [[`COEFFICIENTS`], [`HIDDEN`]]; zeros to rows without one.
    pub fn forward(&mut self, weights: &[f32], hidden: &mut [f32]) {
        let harmonics = Matrix::new(&self.harmonics, COEFFICIENTS);
        let weights = Matrix::new(weights, HIDDEN);
        product(
            &mut self.hidden,
            harmonics,
            weights,
            [COEFFICIENTS, HIDDEN],
            Prologue::Zero,
            Epilogue::Keep,
        );
        let end = self.rows.last().map_or(0, |rows| rows.end);
        // Rows of padding have no direction, and the product is added to what is there.
        hidden[end * HIDDEN..].fill(0.0);
        for (part, rows) in self.hidden.chunks_exact(HIDDEN).zip(&self.rows) {
            let rows = &mut hidden[rows.start * HIDDEN..rows.end * HIDDEN];
            rows.chunks_exact_mut(HIDDEN)
                .for_each(|row| row.copy_from_slice(part));
        }
    }

    /// The backward pass of [`DirectionEncoding::forward`] to the weights: adds to `d_weights` from sums over
    /// the rows of each direction.
    pub fn backward(&mut self, d_hidden: &[f32], d_weights: &mut [f32]) {
        // What each direction added is used up, so its place takes the sums.
        self.hidden.fill(0.0);
        for (sums, rows) in self.hidden.chunks_exact_mut(HIDDEN).zip(&self.rows) {
            // In the rows' order, so that sums have one order.
            for row in d_hidden[rows.start * HIDDEN..rows.end * HIDDEN].chunks_exact(HIDDEN) {
                sums.iter_mut().zip(row).for_each(|(sum, d)| *sum += d);
            }
        }
        let harmonics = Matrix::new(&self.harmonics, COEFFICIENTS);
        let d_directions = Matrix::new(&self.hidden, HIDDEN);
        add_transposed_product(d_weights, harmonics, d_directions, [COEFFICIENTS, HIDDEN]);
    }

    /// The gradients to the harmonics of each direction, after [`DirectionEncoding::backward`].
    pub fn harmonics_backward(&self, weights: &[f32]) -> impl Iterator<Item = [f32; COEFFICIENTS]> {
        let d_directions = self.hidden.chunks_exact(HIDDEN).take(self.rows.len());
        d_directions.map(|d_direction| {
            let rows = weights.chunks_exact(HIDDEN);
            let mut d = [0.0; COEFFICIENTS];
            d.iter_mut().zip(rows).for_each(|(d, row)| {
                *d = row.iter().zip(d_direction).map(|(w, d)| w * d).sum();
            });
            d
        })
    }
}
