//! Back-projection: brings an enlarged image in line with the small one that it was made of. Knows
//! arrays, no files.

use compute::Array;
use compute::elementwise::{add, clamp, sub};
use compute::resize::{Filter, resize};

/// `image [1, C, H, W]` after `rounds` rounds, each of which adds the enlarged difference between
/// `low [1, C, h, w]` and the reduced image, within `range`.
pub fn back_project(image: Array, low: &Array, rounds: u32, range: [f32; 2]) -> Array {
    let size = image.shape().to_vec();
    let reduced = low.shape().to_vec();
    (0..rounds).fold(image, |image, _| {
        let missing = sub(
            low,
            &resize(&image, reduced[2], reduced[3], Filter::BicubicPil, true),
        );
        clamp(
            &add(
                &image,
                &resize(&missing, size[2], size[3], Filter::BicubicTorch, false),
            ),
            range[0],
            range[1],
        )
    })
}
