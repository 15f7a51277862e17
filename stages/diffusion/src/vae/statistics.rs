//! Means and variances for the group normalisations of an image that is computed tile by tile.
//!
//! A normalisation that took them over its own tile would give each tile colours of its own. So the
//! tiles are walked twice: first to gather what each normalisation sees, then to normalise all
//! tiles by the same numbers. Knows neither layers nor tiles, only that every walk meets the same
//! normalisations in the same order.

use compute::Array;

use crate::layers::{GroupMoments, GroupNorm};

/// How normalisations find mean and variance.
pub(super) enum Statistics {
    /// Each over what it is given.
    Own,
    /// Each over what it is given. What it found is kept: for each normalisation, one entry per
    /// tile.
    Gather(Vec<Vec<GroupMoments>>),
    /// Those of all tiles together, for each normalisation.
    Pooled(Vec<GroupMoments>),
}

/// One walk through a network.
pub(super) struct TileWalk<'a> {
    statistics: &'a mut Statistics,
    /// How many normalisations came before.
    met: usize,
}

impl Statistics {
    /// A walk that uses these statistics, or adds to them.
    pub fn walk(&mut self) -> TileWalk<'_> {
        TileWalk {
            statistics: self,
            met: 0,
        }
    }

    /// What was gathered, pooled over tiles.
    pub fn pooled(self) -> Self {
        match self {
            Self::Gather(layers) => Self::Pooled(
                layers
                    .iter()
                    .map(|tiles| GroupMoments::pool(tiles))
                    .collect(),
            ),
            other => other,
        }
    }
}

impl TileWalk<'_> {
    /// The next normalisation of `x [1, C, H, W]`.
    pub fn normalise(&mut self, norm: &GroupNorm, x: &Array) -> Array {
        let met = self.met;
        self.met += 1;
        match self.statistics {
            Statistics::Own => norm.forward(x),
            Statistics::Gather(layers) => {
                // The first tile's walk finds out how many normalisations there are.
                layers.resize_with(layers.len().max(met + 1), Vec::new);
                layers[met].push(norm.moments(x));
                norm.forward(x)
            }
            Statistics::Pooled(layers) => norm.forward_by(x, &layers[met]),
        }
    }
}
