//! The directions that the samples of a block are seen along, and what they add to the colour
//! network's first hidden layer. Knows nothing of the rows' positions.

use crate::kernels::matrix::{Epilogue, Matrix, Prologue, ROWS, add_transposed_product, product};
use crate::network::HIDDEN;
use crate::spherical::{COEFFICIENTS, harmonics};
use std::ops::Range;

/// The directions that the rows of a block are seen along. All that the colour network does with a
/// direction is done once for its rows.
#[derive(Default)]
pub struct Views {
    rows: Vec<Range<usize>>,
    /// Their spherical harmonics, one row each, and rows of zeros until tiles are whole.
    harmonics: Vec<f32>,
    /// What they add to the first hidden layer, or the sum of the gradients to it.
    hidden: Vec<f32>,
}

impl Views {
    /// Says which rows are seen along which unit direction. Ranges follow each other.
    pub fn see(&mut self, views: impl Iterator<Item = ([f32; 3], Range<usize>)>) {
        self.rows.clear();
        self.harmonics.clear();
        for (direction, range) in views {
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
        for (view, rows) in self.hidden.chunks_exact(HIDDEN).zip(&self.rows) {
            let rows = &mut hidden[rows.start * HIDDEN..rows.end * HIDDEN];
            rows.chunks_exact_mut(HIDDEN)
                .for_each(|row| row.copy_from_slice(view));
        }
    }

    /// The backward pass of [`Views::forward`] to the weights: adds to `d_weights` from sums over
    /// the rows of each direction.
    pub fn backward(&mut self, d_hidden: &[f32], d_weights: &mut [f32]) {
        // What each direction added is used up, so its place takes the sums.
        self.hidden.fill(0.0);
        for (view, rows) in self.hidden.chunks_exact_mut(HIDDEN).zip(&self.rows) {
            // In the rows' order, so that sums have one order.
            for row in d_hidden[rows.start * HIDDEN..rows.end * HIDDEN].chunks_exact(HIDDEN) {
                view.iter_mut().zip(row).for_each(|(sum, d)| *sum += d);
            }
        }
        let harmonics = Matrix::new(&self.harmonics, COEFFICIENTS);
        let d_views = Matrix::new(&self.hidden, HIDDEN);
        add_transposed_product(d_weights, harmonics, d_views, [COEFFICIENTS, HIDDEN]);
    }

    /// The gradients to the harmonics of each direction, after [`Views::backward`].
    pub fn harmonics_backward(&self, weights: &[f32]) -> impl Iterator<Item = [f32; COEFFICIENTS]> {
        let d_views = self.hidden.chunks_exact(HIDDEN).take(self.rows.len());
        d_views.map(|d_view| {
            let rows = weights.chunks_exact(HIDDEN);
            let mut d = [0.0; COEFFICIENTS];
            d.iter_mut().zip(rows).for_each(|(d, row)| {
                *d = row.iter().zip(d_view).map(|(w, d)| w * d).sum();
            });
            d
        })
    }
}
