//! How a product is cut into tiles, and along its depth. It knows extents, not factors.

use crate::runtime::gpu::tile::{LARGE, SQUARE, Tile};

/// Tiles per product below which the depth is cut as well, so that a large GPU has something for
/// each of its processors.
const ENOUGH_TILES: usize = 64;
/// The least depth that is worth a workgroup of its own.
const LEAST_DEPTH: usize = 256;

/// For results of few columns, where a square tile would be mostly padding.
const TALL: Tile = Tile {
    rows: 256,
    columns: 16,
    depth: 16,
    per_invocation: [4, 4],
};
/// For results of few rows.
const WIDE: Tile = Tile {
    rows: 16,
    columns: 256,
    depth: 16,
    per_invocation: [4, 4],
};

/// How a product is cut.
pub struct Tiling {
    /// The tile of one workgroup.
    pub tile: Tile,
    /// Tiles by column and by row.
    pub tiles: [usize; 2],
    /// Parts of the depth.
    pub parts: usize,
    /// The depth of a part.
    pub chunk: usize,
}

impl Tiling {
    /// Of a product of so many rows, depth and columns in tiles of one's choice. The depth is cut
    /// as the [usual] tile has it, whichever is chosen: so that all give the same bits.
    pub fn new([rows, depth, columns]: [usize; 3], tile: Tile) -> Tiling {
        let usual = usual(rows, columns);
        let enough = usual.count(rows, columns).iter().product::<usize>();
        // By extents alone, never by the adapter: the cut decides the order of sums.
        let parts = (depth / LEAST_DEPTH)
            .min(ENOUGH_TILES / enough.max(1))
            .clamp(1, 32);
        let chunk = depth.div_ceil(parts).next_multiple_of(usual.depth);
        Tiling {
            tile,
            tiles: tile.count(rows, columns),
            parts: depth.div_ceil(chunk).max(1),
            chunk,
        }
    }
}

/// The tile of a product, or whether it has enough of the large ones for an adapter's own choice.
pub enum Choice {
    /// One extent is short: there is one tile for that.
    Thin(Tile),
    /// What an adapter is fastest with decides; whether there are many tiles.
    Tuned { many: bool },
}

/// Which tile suits a product of so many rows and columns.
pub fn choose(rows: usize, columns: usize) -> Choice {
    match usual(rows, columns) {
        tile if tile == TALL || tile == WIDE => Choice::Thin(tile),
        tile => Choice::Tuned {
            many: tile == LARGE,
        },
    }
}

/// The largest tile that leaves enough of them; long ones where one extent is short.
fn usual(rows: usize, columns: usize) -> Tile {
    let large = rows.div_ceil(LARGE.rows) * columns.div_ceil(LARGE.columns);
    match (rows, columns) {
        // A square tile would compute mostly what is beyond the edge.
        (_, ..=16) if rows > 16 => TALL,
        (..=16, _) => WIDE,
        _ if large >= ENOUGH_TILES && rows > 64 && columns > 64 => LARGE,
        _ => SQUARE,
    }
}
