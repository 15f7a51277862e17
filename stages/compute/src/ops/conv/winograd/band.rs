//! Some channels: a band of output rows is worked through while all of it stays in the second
//! cache. A panel of its tiles is transformed, multiplied at 36 spots by a block of outputs, and
//! transformed back; so transformed tiles never go to memory. Bands share nothing, and run in
//! parallel.

use super::extents::{BLOCK, COLUMNS, DEPTH, SPOTS, WIDEST};
use super::kernels::{Lines, Multiply};
use super::panel::{Panel, across, cut, down};
use super::quads::run;
use super::task::Task;
use super::weights::Kernels;
use crate::ops::conv::geometry::Geometry;
use crate::ops::product::cpu::tile::Old;
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::matrix::MatrixMut;
use crate::runtime::cpu::share::Share;

/// The most channels whose transformed panel, 4.5 KiB for each, leaves room in the second cache for
/// the kernels and the sums of a block of outputs. All of them are summed at once.
const CHANNELS: usize = DEPTH;
/// Tiles of a band, if there are enough: a whole number of panels, so that few are left over.
const TILES: usize = 4 * COLUMNS;
/// Bands are made shorter until there are so many, whatever the number of threads.
const BANDS: usize = 16;
/// Fewer bands leave too little to do for several threads.
const FEWEST: usize = 4;

/// Outputs between what is transformed back and what is asked of memory.
const AHEAD: usize = 2;

/// Rows of tiles per band.
fn rows(g: &Geometry) -> usize {
    let tiles = g.batch * down(g) * across(g);
    // By tiles and not by threads, so that the cut is the same everywhere.
    ((tiles / BANDS).clamp(COLUMNS, TILES) / across(g)).max(1)
}

/// Whether the convolution has few enough channels, and enough rows.
pub fn suits(g: &Geometry) -> bool {
    g.channels <= CHANNELS && (g.batch * down(g)).div_ceil(rows(g)) >= FEWEST
}

/// Convolves, by all threads.
pub fn convolve(task: &Task, kernels: &Kernels) -> HostBuffer {
    let g = task.g;
    let mut out = HostBuffer::uninitialised(g.batch * g.outputs * g.pixels());
    cut(g, g.outputs, rows(g)).for_each_share(&mut out, |mut share| {
        let mut space = Space::new(g);
        for panel in Panel::all(g, share.panels.clone()) {
            space.transform(&panel, task.x);
            // The panel's tiles stay in the cache while all outputs meet them.
            for block in 0..g.outputs.div_ceil(BLOCK) {
                for output in block * BLOCK..g.outputs.min(block * BLOCK + AHEAD) {
                    panel.prefetch_outputs((&mut share, output), task.finish);
                }
                space.multiply(kernels, block);
                space.transform_back(&panel, block, task, &mut share);
            }
        }
    });
    out
}

/// What a band needs while it is worked through; buffers are kept for the next one.
struct Space {
    lines: Lines,
    channels: usize,
    /// (S, C, P): the transformed tiles.
    tiles: HostBuffer,
    /// (R, S, P): their products with a block's kernels. A row is what one output channel's way
    /// back reads; behind the last, a vector may read on.
    sums: HostBuffer,
}

impl Space {
    fn new(g: &Geometry) -> Space {
        Space {
            lines: Lines::new(),
            channels: g.channels,
            tiles: HostBuffer::uninitialised(SPOTS * g.channels * COLUMNS),
            sums: HostBuffer::uninitialised(BLOCK * SPOTS * COLUMNS + WIDEST),
        }
    }

    fn transform(&mut self, panel: &Panel, x: &[f32]) {
        let mut tiles = MatrixMut::new(&mut self.tiles, SPOTS, self.channels * COLUMNS);
        for channel in 0..self.channels {
            let mut spots = tiles.block(0..SPOTS, channel * COLUMNS..(channel + 1) * COLUMNS);
            panel.transform_inputs(x, channel, &mut self.lines, &mut spots);
        }
    }

    fn multiply(&mut self, kernels: &Kernels, block: usize) {
        let mut sums = MatrixMut::new(&mut self.sums, BLOCK, SPOTS * COLUMNS);
        for (spot, tiles) in self.tiles.chunks(self.channels * COLUMNS).enumerate() {
            run(Multiply {
                kernels: kernels.at(block, spot, 0..self.channels),
                tiles,
                sums: sums.block(0..BLOCK, spot * COLUMNS..(spot + 1) * COLUMNS),
                old: Old::Forget,
            });
        }
    }

    fn transform_back(&mut self, panel: &Panel, block: usize, task: &Task, share: &mut Share) {
        let outputs = block * BLOCK..task.g.outputs.min((block + 1) * BLOCK);
        for (row, output) in outputs.clone().enumerate() {
            // The first ones were asked for before the products.
            if outputs.contains(&(output + AHEAD)) {
                panel.prefetch_outputs((share, output + AHEAD), task.finish);
            }
            let spots = &self.sums[row * SPOTS * COLUMNS..];
            panel.transform_outputs(spots, (share, output), task.bias(output), task.finish);
        }
    }
}
