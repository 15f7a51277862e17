//! What the hash grid holds at some positions, level by level, so that one level stays in the cache
//! while all positions pass. Knows nothing of rays.

use crate::config::{FEATURES, Level};
use crate::field::Field;
use crate::kernels::hash::{Entry, encode};
use crate::kernels::matrix::ROWS;
use crate::positions::Positions;

/// Positions and their features.
#[derive(Default)]
pub struct Features {
    /// Where to look; whoever adds some fills the last group.
    pub positions: Positions,
    /// `[level][position]`, as far as look-ups have come.
    levels: Vec<Vec<[f32; FEATURES]>>,
}

/// The look-up of some positions in one level.
pub struct LookUp<'a> {
    level: &'a Level,
    table: &'a [Entry],
    positions: &'a Positions,
    features: &'a mut Vec<[f32; FEATURES]>,
}

impl LookUp<'_> {
    /// Writes the features of the positions that were added since the last look-up.
    pub fn run(self) {
        let done = self.features.len();
        // Only what was added since the last look-up.
        self.features.resize(self.positions.len(), [0.0; FEATURES]);
        encode(
            self.level,
            self.table,
            self.positions.since(done),
            &mut self.features[done..],
        );
    }
}

impl Features {
    /// Forgets everything, and makes room for a field's levels.
    pub fn clear(&mut self, field: &Field) {
        self.positions.clear();
        self.levels.resize(field.levels.len(), vec![]);
        self.levels.iter_mut().for_each(Vec::clear);
    }

    /// The look-ups that the positions added since the last call need, one for each level; each may
    /// run on any thread.
    pub fn look_ups<'a>(&'a mut self, field: &'a Field) -> impl Iterator<Item = LookUp<'a>> {
        let positions = &self.positions;
        self.levels
            .iter_mut()
            .zip(&field.levels)
            .map(|(features, level)| {
                let table = &field.table[level.offset..level.offset + level.entries];
                LookUp {
                    level,
                    table,
                    positions,
                    features,
                }
            })
    }

    /// Writes the features of some positions as rows of `width`, and rows of zeros until the
    /// kernels' tiles are whole.
    pub fn rows(
        &self,
        positions: impl ExactSizeIterator<Item = usize>,
        width: usize,
        rows: &mut Vec<f32>,
    ) {
        rows.resize(positions.len().next_multiple_of(ROWS) * width, 0.0);
        // The buffer is used again and again, so that its end may hold other rows.
        rows[positions.len() * width..].fill(0.0);
        for (row, position) in rows.chunks_exact_mut(width).zip(positions) {
            for (out, level) in row
                .as_chunks_mut::<FEATURES>()
                .0
                .iter_mut()
                .zip(&self.levels)
            {
                *out = level[position];
            }
        }
    }
}
