//! The directions that the samples of a block are seen along, and what they add to the colour network's first hidden
//! layer. Knows nothing of the weights.

use crate::kernels::matrix::ROWS;
use crate::network::HIDDEN;
use crate::spherical::{COEFFICIENTS, harmonics};
use std::ops::Range;

/// The directions that the rows of a block are seen along. All that the colour network does with a direction is done
/// once for its rows.
#[derive(Default)]
pub struct Views {
    rows: Vec<Range<usize>>,
    /// Their spherical harmonics, one row each, and rows of zeros until tiles are whole.
    pub harmonics: Vec<f32>,
    /// What they add to the first hidden layer, or the sum of the gradients to it.
    pub hidden: Vec<f32>,
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

    /// Writes what each direction adds to its rows of the first hidden layer; zeros to those of none.
    pub fn spread(&self, hidden: &mut [f32]) {
        let end = self.rows.last().map_or(0, |rows| rows.end);
        hidden[end * HIDDEN..].fill(0.0);
        for (view, rows) in self.hidden.chunks_exact(HIDDEN).zip(&self.rows) {
            let rows = &mut hidden[rows.start * HIDDEN..rows.end * HIDDEN];
            rows.chunks_exact_mut(HIDDEN).for_each(|row| row.copy_from_slice(view));
        }
    }

    /// The backward pass of [`Views::spread`]: sums over the rows of each direction.
    pub fn spread_backward(&mut self, d_hidden: &[f32]) {
        self.hidden.fill(0.0);
        for (view, rows) in self.hidden.chunks_exact_mut(HIDDEN).zip(&self.rows) {
            for row in d_hidden[rows.start * HIDDEN..rows.end * HIDDEN].chunks_exact(HIDDEN) {
                view.iter_mut().zip(row).for_each(|(sum, d)| *sum += d);
            }
        }
    }
}
