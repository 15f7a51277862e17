//! How tiles, panels and blocks are measured.

pub use crate::ops::product::cpu::tile::COLUMNS;

/// Outputs of a tile, each way.
pub const SIDE: usize = 4;
/// Inputs that a tile sees, each way.
pub const SIGHT: usize = 6;
/// Numbers of a transformed tile.
pub const SPOTS: usize = SIGHT * SIGHT;

/// Outputs whose kernels are packed side by side: a cache line of them.
pub const BLOCK: usize = 16;
/// The most lanes of a vector.
pub const WIDEST: usize = 16;
/// Pixels of a line that the tiles of a panel see.
pub const SEEN: usize = SIDE * COLUMNS + SIGHT - SIDE;
/// Terms after which the total joins what the result holds. With the length of a chain (`multiply`)
/// it decides the order of a sum, and so its bits.
pub const DEPTH: usize = 128;
