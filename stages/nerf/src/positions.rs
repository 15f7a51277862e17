//! Places in unit space, laid out for the kernels. Knows nothing of what is there.

use crate::kernels::hash::LANES;
use std::ops::Range;

/// Positions in unit space, one array per axis.
#[derive(Clone, Debug, Default)]
pub struct Positions(pub [Vec<f32>; 3]);

impl Positions {
    /// How many there are, padding included.
    pub fn len(&self) -> usize {
        self.0[0].len()
    }

    /// Adds a position at the end, behind padding if there is any.
    pub fn push(&mut self, position: [f32; 3]) {
        self.0
            .iter_mut()
            .zip(position)
            .for_each(|(axis, x)| axis.push(x));
    }

    /// The coordinates of position number `index`.
    pub fn at(&self, index: usize) -> [f32; 3] {
        self.0.each_ref().map(|axis| axis[index])
    }

    /// Repeats the origin until whole groups are full.
    pub fn pad(&mut self) {
        let len = self.len().next_multiple_of(LANES);
        self.0.iter_mut().for_each(|axis| axis.resize(len, 0.0));
    }

    /// Adds some of `from`.
    pub fn extend(&mut self, from: &Self, range: Range<usize>) {
        self.0
            .iter_mut()
            .zip(&from.0)
            .for_each(|(axis, from)| axis.extend_from_slice(&from[range.clone()]));
    }

    /// Adds those of `from` with these indices.
    pub fn gather(&mut self, from: &Self, indices: &[u32]) {
        for (axis, from) in self.0.iter_mut().zip(&from.0) {
            axis.extend(indices.iter().map(|&index| from[index as usize]));
        }
    }

    pub fn clear(&mut self) {
        self.0.iter_mut().for_each(Vec::clear);
    }

    /// The coordinates of all positions from number `first` on, one array per axis.
    pub fn since(&self, first: usize) -> [&[f32]; 3] {
        self.0.each_ref().map(|axis| &axis[first..])
    }
}
