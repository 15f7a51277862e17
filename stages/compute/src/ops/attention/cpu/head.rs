//! One head among the tokens of all, and the tiles that its queries and keys are cut into. It knows
//! no scores.

use crate::ops::attention::extents::Extents;
use crate::runtime::cpu::matrix::Matrix;

/// Queries per block: its scores are one tile.
// Four tiles of a product's rows.
pub const QUERIES: usize = 48;
/// Blocks of queries per task, which meet the same packed keys.
pub const BLOCKS: usize = 8;
/// Keys per tile of scores.
// With 48 queries a tile of scores takes 96 KiB.
pub const KEYS: usize = 512;

impl Extents {
    /// One head's rows `first..first + rows` of one image's tokens.
    pub fn head<'a>(
        &self,
        tokens: &'a [f32],
        head: usize,
        first: usize,
        rows: usize,
    ) -> Matrix<'a> {
        Matrix::strided(
            &tokens[first * self.width() + head * self.depth..],
            rows,
            self.depth,
            self.width(),
        )
    }
}
