//! How much a training step gives a device to do, by formula: how many samples there are, the
//! device alone knows until the step is over.

use crate::config::Level;
use crate::network::{COLOR_OUTPUT, HIDDEN, Network};

/// Workgroups that take turns at the samples of a backward pass, each with a sum of its own of the
/// gradient to the weights.
pub const PARTS: u32 = 256;

/// What a kernel has to do: operations, a multiplication and its addition being two, and bytes
/// through device memory if each array goes through once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Floating-point operations of look-ups and networks.
    pub operations: u64,
    /// Bytes from and to device memory.
    pub bytes: u64,
}

/// The sizes that decide the work of a step.
pub struct Extent {
    /// Rays of the batch, all passes together.
    pub rays: usize,
    /// Pixels of the batch.
    pub pixels: usize,
    /// Samples whose density was computed to find the ends of rays.
    pub queried: usize,
    /// Samples that passed through both networks.
    pub samples: usize,
}

/// Of every kernel of a training step, without the occupancy grid's update.
pub fn of_step(extent: &Extent, levels: &[Level], network: &Network) -> Vec<(&'static str, Work)> {
    let &Extent {
        rays,
        pixels,
        queried,
        samples,
    } = extent;
    let weights = network.weights.len();
    let encoding = network.layers[0].inputs;
    // Eight corners of two features each. An entry has four bytes, its gradient two words for each
    // feature, read and written.
    let look_up = 32 * levels.len();
    let corners = 32 * levels.len();
    let scattered = 8 * levels.len() * 2 * 8;
    let query = 2 * (encoding * HIDDEN + HIDDEN) + look_up;
    let backward = 2 * (weights - HIDDEN * COLOR_OUTPUT) + 4 * weights + 2 * look_up;
    let touched: usize = levels
        .iter()
        .map(|level| level.entries.min(8 * samples))
        .sum();
    let entries: usize = levels.iter().map(|level| level.entries).sum();
    let parts = PARTS as usize * weights * 4;
    // Bytes: a ray has 64, what it sees 32, a sample 16, its raw numbers 16, a pixel 32, a count 4.
    let works = [
        (
            "ray termination",
            queried * query,
            queried * corners + rays * 68,
        ),
        ("scan", 0, rays * 8),
        ("gather", 0, samples * 16 + rays * 76),
        (
            "shade",
            samples * (2 * weights + look_up),
            samples * (32 + corners) + 4 * weights,
        ),
        ("composite", 0, samples * 36 + rays * 36),
        (
            "composite backward",
            0,
            samples * 64 + rays * 100 + pixels * 40,
        ),
        ("stats", 0, rays * 8 + pixels * 8),
        (
            "backward",
            samples * backward,
            samples * (32 + corners + scattered) + parts,
        ),
        (
            "Adam, networks",
            PARTS as usize * weights,
            parts + weights * 28,
        ),
        // All gradients are read. Of entries that have one, values, moments, counts and halves
        // change too.
        ("Adam, table", 0, entries * 16 + touched * 60),
    ];
    let work = |(name, operations, bytes)| {
        (
            name,
            Work {
                operations: operations as u64,
                bytes: bytes as u64,
            },
        )
    };
    works.map(work).to_vec()
}
