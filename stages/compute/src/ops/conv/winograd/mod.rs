//! 3x3 convolution of stride 1 by Winograd's minimal filtering, in tiles of 4x4 outputs: a quarter
//! of the multiplications. Lavin and Gray 2015, section 4.
//!
//! A tile is the 6x6 inputs that 4x4 outputs see. Its transform has a number for each channel at 36
//! spots; at each spot these are multiplied by the transformed kernels and summed over the
//! channels, which is a product of matrices; and what that gives is transformed back. Few channels
//! go [by bands](band), many go [by outputs](deep); both sum in the same order, and the bits are
//! the same.

mod band;
mod deep;
mod extents;
mod kernels;
mod panel;
mod quads;
pub mod task;
#[cfg(test)]
mod tests;
mod transform;
pub mod weights;

use std::sync::OnceLock;

use super::geometry::Geometry;
use crate::runtime::cpu::buffer::HostBuffer;
use deep::TransformedKernels;
use extents::{COLUMNS, SIDE, SPOTS};
use task::Task;
use weights::{Kernels, StoredKernels};

/// The fewest channels, in and out: upsamplers have 48, and take a third less time so. With fewer,
/// plain sums take hardly longer, and networks so narrow normalise groups of so few numbers that
/// rounding shows.
const NARROWEST: usize = 48;

/// What the transform of a pair's kernel costs, in products of the plain sum. Measured at 48 to 512
/// channels: where the filtering saves 288 products beside half of them, the plain sum takes 5 to
/// 20 % less time, and where it saves 576, 5 to 25 % more.
const TRANSFORM: usize = 432;

/// Whether the transforms pay: there must be enough products per transformed number, and full
/// panels of tiles. Kernels are transformed at each call unless they are `kept`.
pub fn suits(g: &Geometry, kept: bool) -> bool {
    let tiles = g.batch * g.out_height.div_ceil(SIDE) * g.out_width.div_ceil(SIDE);
    // Products for each pair of an input and an output channel.
    let direct = 9 * g.batch * g.pixels();
    let here = SPOTS * tiles.next_multiple_of(COLUMNS);
    let transform = if kept { 0 } else { TRANSFORM };
    g.kernel == [3, 3]
        && g.conv.stride == 1
        && g.channels.min(g.outputs) >= NARROWEST
        // Half the products saved at least, with the empty places of panels and edges counted.
        && direct >= 2 * here + transform
}

/// Convolves every image, and adds the bias. Kernels that are transformed as a whole go to `kept`,
/// if there is such a place, or are found there.
pub fn convolve(
    task: &Task,
    stored: StoredKernels,
    kept: Option<&OnceLock<HostBuffer>>,
) -> HostBuffer {
    let channels = task.g.channels;
    let kept = kept.map(|kept| Kernels::new(kept.get_or_init(|| stored.transform()), channels));
    match (band::suits(task.g), kept) {
        (true, Some(kernels)) => band::convolve(task, &kernels),
        // Bands want all kernels; for few channels these are small.
        (true, None) => band::convolve(task, &Kernels::new(&stored.transform(), channels)),
        (false, Some(kernels)) => deep::convolve(task, &TransformedKernels::Whole(kernels)),
        (false, None) => deep::convolve(task, &TransformedKernels::Parts(stored)),
    }
}
