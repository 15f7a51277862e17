//! How a workgroup cuts a matrix product. It knows no factors.

use std::fmt;

/// How a product is cut: rows, columns and depth of a tile, rows and columns of one invocation. All
/// have 256 invocations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    pub rows: usize,
    pub columns: usize,
    pub depth: usize,
    pub per_invocation: [usize; 2],
}

/// The tile that reads the factors the least often.
pub const LARGE: Tile = Tile {
    rows: 128,
    columns: 128,
    depth: 8,
    per_invocation: [8, 8],
};
/// The tile that cuts a product into the most parts.
pub const SQUARE: Tile = Tile {
    rows: 64,
    columns: 64,
    depth: 16,
    per_invocation: [4, 4],
};
const HIGH: Tile = Tile {
    rows: 128,
    columns: 64,
    depth: 16,
    per_invocation: [8, 4],
};
const BROAD: Tile = Tile {
    rows: 64,
    columns: 128,
    depth: 16,
    per_invocation: [4, 8],
};
/// What an adapter's tuning chooses from.
pub const TILES: [Tile; 4] = [SQUARE, HIGH, BROAD, LARGE];

impl Tile {
    /// How many of them a product has, by column and by row.
    pub fn count(self, rows: usize, columns: usize) -> [usize; 2] {
        [columns.div_ceil(self.columns), rows.div_ceil(self.rows)]
    }

    /// What the template of products calls them.
    pub fn constants(self) -> Vec<(&'static str, u32)> {
        let [rows, columns] = self.per_invocation;
        // Four numbers to a vector, and one vector left free, so that columns are not in one bank.
        let pitches = [self.rows / 4 + 1, self.columns / 4 + 1];
        let named = [
            ("TM", self.rows),
            ("TN", self.columns),
            ("TK", self.depth),
            ("RM", rows),
            ("RN", columns),
            ("QM", rows / 4),
            ("QN", columns / 4),
            ("A_PITCH", pitches[0]),
            ("B_PITCH", pitches[1]),
            ("A_TILE", self.depth * pitches[0]),
            ("B_TILE", self.depth * pitches[1]),
        ];
        named.map(|(name, value)| (name, value as u32)).to_vec()
    }
}

impl fmt::Display for Tile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.rows, self.columns)
    }
}
