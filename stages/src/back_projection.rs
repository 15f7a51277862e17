//! Back-projection: brings an enlarged image in line with the small one that it was made of. Knows
//! arrays, no files.

use compute::Array;
use compute::elementwise::{add, clamp, mul, sub};
use compute::resize::{Filter, resize};

/// `image [1, C, H, W]` after `rounds` rounds, each of which adds the enlarged difference between
/// `low [1, C, h, w]` and the reduced image, within `range`. Where `counts`, of the shape of `low`,
/// is 0, `low` has no say; `None` stands for ones.
pub fn back_project(
    image: Array,
    low: &Array,
    counts: Option<&Array>,
    rounds: u32,
    range: [f32; 2],
) -> Array {
    let size = image.shape().to_vec();
    let reduced = low.shape().to_vec();
    (0..rounds).fold(image, |image, _| {
        let missing = sub(
            low,
            // The filter that made the low-resolution photos, so that what was made of one reduces
            // to it.
            &resize(&image, reduced[2], reduced[3], Filter::BicubicPil, true),
        );
        let missing = match counts {
            Some(counts) => mul(&missing, counts),
            None => missing,
        };
        // In every round: what is clipped must be missing in the next.
        clamp(
            &add(
                &image,
                // PyTorch's bicubic, as everywhere else where the program enlarges.
                &resize(&missing, size[2], size[3], Filter::BicubicTorch, false),
            ),
            range[0],
            range[1],
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use compute::Device;

    #[test]
    fn masked_pixels_have_no_say() {
        let device = Device::cpu();
        let image = device.array(&[1, 1, 8, 8], vec![0.5; 64]);
        let low = device.array(&[1, 1, 2, 2], vec![1.0, 0.5, 0.5, 0.5]);
        let counts = device.array(&[1, 1, 2, 2], vec![0.0, 1.0, 1.0, 1.0]);
        let masked = back_project(image.clone(), &low, Some(&counts), 3, [0.0, 1.0]);
        assert_eq!(masked.to_vec(), image.to_vec());
        let all = back_project(image.clone(), &low, None, 3, [0.0, 1.0]);
        assert!(all.to_vec() != image.to_vec());
    }
}
