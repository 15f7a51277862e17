//! The mean over the eight ways in which an image can be turned and mirrored, each enlarged and put
//! back: it costs eight times as much, and gains a tenth of a decibel or so (Timofte et al. 2016).
//! Sums in a fixed order.

use compute::Array;

/// The eight ways: whether axes are exchanged, rows reversed, columns reversed, in this order.
const WAYS: [[bool; 3]; 8] = {
    let f = false;
    let t = true;
    [
        [f, f, f],
        [f, f, t],
        [f, t, f],
        [f, t, t],
        [t, f, f],
        [t, f, t],
        [t, t, f],
        [t, t, t],
    ]
};

/// The mean of what `enlarge` makes of `x [N, C, H, W]` in all eight ways.
pub fn mean(x: &Array, enlarge: impl Fn(&Array) -> Array) -> Array {
    let mut sum: Option<(Vec<f32>, Vec<usize>)> = None;
    for [exchanged, down, across] in WAYS {
        let turned = mirrored(
            &if exchanged { transposed(x) } else { x.clone() },
            down,
            across,
        );
        // Undone in the opposite order.
        let back = mirrored(&enlarge(&turned), down, across);
        let back = if exchanged { transposed(&back) } else { back };
        let values = back.to_vec();
        match &mut sum {
            None => sum = Some((values, back.shape().to_vec())),
            Some((sum, _)) => sum
                .iter_mut()
                .zip(values)
                .for_each(|(sum, value)| *sum += value),
        }
    }
    let (sum, shape) = sum.unwrap_or_default();
    // Added in the order of WAYS, so that the mean has the same bits each time.
    x.device().array(
        &shape,
        sum.into_iter().map(|sum| sum / WAYS.len() as f32).collect(),
    )
}

/// Height and width exchanged.
fn transposed(x: &Array) -> Array {
    let [n, c, h, w] = [0, 1, 2, 3].map(|axis| x.shape()[axis]);
    let values = x.to_vec();
    let column = |i: usize| (0..h).map(move |y| (i / w * h + y) * w + i % w);
    x.device().array(
        &[n, c, w, h],
        (0..n * c * w).flat_map(column).map(|i| values[i]).collect(),
    )
}

/// The rows, and the pixels in each row, in reverse order where asked for.
fn mirrored(x: &Array, down: bool, across: bool) -> Array {
    if !down && !across {
        return x.clone();
    }
    let [h, w] = [x.shape()[2], x.shape()[3]];
    let mut values = x.to_vec();
    for plane in values.chunks_mut(h * w) {
        if down && across {
            plane.reverse();
        } else if across {
            plane.chunks_mut(w).for_each(<[f32]>::reverse);
        } else {
            let old = plane.to_vec();
            plane
                .chunks_mut(w)
                .zip(old.chunks(w).rev())
                .for_each(|(new, old)| new.copy_from_slice(old));
        }
    }
    x.device().array(x.shape(), values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use compute::Device;

    #[test]
    fn what_treats_all_ways_alike_is_its_own_mean() {
        let x = Device::cpu().array(&[2, 1, 3, 5], (0..30).map(|i| i as f32).collect());
        assert_eq!(mean(&x, |x| x.clone()).to_vec(), x.to_vec());
    }

    #[test]
    fn the_mean_is_over_eight_different_ways() {
        let x = Device::cpu().array(&[1, 1, 2, 2], vec![1., 2., 4., 8.]);
        // Keeps the first pixel alone: of each pixel, it is the first in two ways of eight.
        let first =
            |x: &Array| Device::cpu().array(x.shape(), [x.to_vec()[0], 0., 0., 0.].to_vec());
        assert_eq!(mean(&x, first).to_vec(), [0.25, 0.5, 1., 2.]);
    }
}
