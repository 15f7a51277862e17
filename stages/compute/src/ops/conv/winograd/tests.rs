//! Convolutions large enough for the filtering, against sums in `f64`.

use proptest::prelude::*;

use super::suits;
use crate::activation::leaky_relu;
use crate::check::{self, assert_adjoint, assert_same_bits, dot, pattern};
use crate::conv::geometry::Geometry;
use crate::conv::{Conv, Finish, conv2d, conv2d_backward_input, conv2d_finished};
use crate::elementwise::{add, sub};
use crate::{Array, Weight};

/// The 3x3 convolution's output (`image`, `channel`, `y`, `x`), summed in `f64`.
fn exact(
    input: &Array,
    weight: &Array,
    pad: [usize; 4],
    [image, channel, y, x]: [usize; 4],
) -> f64 {
    let &[_, c, h, w] = input.shape() else {
        panic!("four axes")
    };
    let values = input.to_vec();
    let kernels = weight.to_vec();
    let tap = |i: usize, ky: usize, kx: usize| match (
        (y + ky).checked_sub(pad[0]),
        (x + kx).checked_sub(pad[2]),
    ) {
        (Some(row), Some(column)) if row < h && column < w => {
            let kernel = kernels[(channel * c + i) * 9 + ky * 3 + kx];
            f64::from(values[((image * c + i) * h + row) * w + column]) * f64::from(kernel)
        }
        _ => 0.0,
    };
    (0..c)
        .map(|i| (0..9).map(|t| tap(i, t / 3, t % 3)).sum::<f64>())
        .sum()
}

/// Independent numbers. `pattern`'s are not: at some widths the channels' products cancel, and an
/// error relative to what is left of them says little.
fn normals(salt: u64, shape: &[usize]) -> Array {
    check::normals("winograd", salt, shape)
}

/// The norm of the error over the norm of the result, over every `step`-th output.
fn error(input: &Array, weight: &Array, pad: [usize; 4], step: usize) -> f64 {
    let y = conv2d(input, weight, None, Conv { stride: 1, pad });
    let &[_, o, h, w] = y.shape() else {
        panic!("four axes")
    };
    let mut difference = 0.0;
    let mut size = 0.0;
    for (i, got) in y.to_vec().into_iter().enumerate().step_by(step) {
        let expected = exact(
            input,
            weight,
            pad,
            [i / (o * h * w), i / (h * w) % o, i / w % h, i % w],
        );
        difference += (f64::from(got) - expected).powi(2);
        size += expected.powi(2);
    }
    (difference / size).sqrt()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 10))]

    #[test]
    fn any_size_and_padding_is_right(
        (n, c, o) in (1usize..3, 48usize..72, 48usize..72),
        (h, w) in (13usize..40, 13usize..40),
        pad in prop::array::uniform4(0usize..4),
    ) {
        let x = normals(1, &[n, c, h, w]);
        let weight = normals(2, &[o, c, 3, 3]);
        prop_assert!(error(&x, &weight, pad, 97) < 1.5e-6);
        let conv = Conv { stride: 1, pad };
        let y = conv2d(&x, &weight, None, conv);
        let dy = normals(3, y.shape());
        let dx = conv2d_backward_input(&dy, &weight, conv, [h, w]);
        assert_adjoint("input", &y, &dy, dot(&x, &dx));
    }

    /// Whether filtered or not, by bands or by outputs, and of whatever size.
    #[test]
    fn finishing_a_result_is_the_operator_behind_it(
        n in 1usize..3,
        c in prop::sample::select(vec![3usize, 48, 61, 64, 130]),
        o in prop::sample::select(vec![5usize, 48, 64, 67]),
        (h, w) in (5usize..60, 5usize..60),
        pad in prop::array::uniform4(0usize..3),
        slope in prop::sample::select(vec![0.0f32, 0.2, -1.5]),
    ) {
        let x = normals(1, &[n, c, h, w]);
        let weight = normals(2, &[o, c, 3, 3]);
        let bias = normals(3, &[o]);
        let conv = Conv { stride: 1, pad };
        let finished = |finish| conv2d_finished(&x, &weight, Some(&bias), conv, finish);
        let y = conv2d(&x, &weight, Some(&bias), conv);
        let other = normals(4, y.shape());
        prop_assert_eq!(finished(Finish::None).to_vec(), y.to_vec());
        prop_assert_eq!(finished(Finish::Leaky(slope)).to_vec(), leaky_relu(&y, slope).to_vec());
        prop_assert_eq!(finished(Finish::Add(&other)).to_vec(), add(&other, &y).to_vec());
    }

    /// On small images, plain sums may take less time than kernels that are not kept.
    #[test]
    fn kept_transforms_are_those_of_their_weight(
        c in prop::sample::select(vec![48usize, 64, 130]),
        o in prop::sample::select(vec![48usize, 67]),
        (h, w) in (13usize..60, 13usize..60),
    ) {
        let weight = normals(2, &[o, c, 3, 3]);
        let kept = Weight::from(&weight).keeping_transforms();
        let same = chosen([1, c, h, w], o, true) == chosen([1, c, h, w], o, false);
        // The second time they are found.
        for salt in [1, 3] {
            let x = normals(salt, &[1, c, h, w]);
            let expected = conv2d(&x, &weight, None, Conv::padded(1));
            let got = conv2d(&x, &kept, None, Conv::padded(1));
            if same {
                prop_assert_eq!(got.to_vec(), expected.to_vec());
            } else {
                prop_assert!(distance(&got, &expected) < 2e-6);
            }
        }
    }
}

/// Whether a padded convolution is filtered, if its transforms are kept or not.
fn chosen(input: [usize; 4], outputs: usize, kept: bool) -> bool {
    let g = Geometry::new("conv2d", input, outputs, [3, 3], Conv::padded(1));
    suits(&g, kept)
}

/// The norm of the difference over the norm of `expected`.
fn distance(got: &Array, expected: &Array) -> f64 {
    let squares = |x: &[f32]| x.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
    (squares(&sub(got, expected).to_vec()) / squares(&expected.to_vec())).sqrt()
}

#[test]
fn few_pixels_are_filtered_only_with_kept_transforms() {
    // The pixels of a batch count together.
    for (input, kept, anew) in [
        ([1, 512, 12, 12], false, false),
        ([1, 512, 16, 16], true, false),
        ([4, 128, 8, 8], true, false),
        ([2, 64, 12, 12], true, false),
        ([4, 64, 12, 12], true, true),
        ([1, 256, 24, 24], true, true),
        ([1, 32, 24, 24], false, false),
    ] {
        let outputs = input[1];
        assert_eq!(chosen(input, outputs, true), kept, "{input:?}");
        assert_eq!(chosen(input, outputs, false), anew, "{input:?}");
    }
}

#[test]
fn plain_sums_and_filtered_ones_agree_at_the_border() {
    for input in [[1, 48, 16, 16], [4, 130, 8, 8], [2, 64, 12, 12]] {
        let x = normals(1, &input);
        let weight = normals(2, &[50, input[1], 3, 3]);
        let kept = Weight::from(&weight).keeping_transforms();
        let plain = conv2d(&x, &weight, None, Conv::padded(1));
        let filtered = conv2d(&x, &kept, None, Conv::padded(1));
        let error = distance(&filtered, &plain);
        assert!(0.0 < error && error < 2e-6, "{input:?}: {error}");
    }
}

/// A sum of short sums must not depend on how tiles and outputs are shared out: wide images and
/// narrow ones, of the same pixels around the one that is compared.
#[test]
fn a_pixel_does_not_know_how_large_its_image_is() {
    for (c, o) in [(64, 64), (130, 50)] {
        let x = normals(1, &[1, c, 64, 76]);
        let weight = normals(2, &[o, c, 3, 3]);
        let whole = conv2d(&x, &weight, None, Conv::padded(1));
        let part = crate::shape::crop(&x, 8, 16, 36, 40);
        let part = conv2d(&part, &weight, None, Conv::padded(1));
        // Beyond the edges, where one sees padding and the other does not.
        let inside = |y: &Array, top, left| crate::shape::crop(y, top, left, 28, 32).to_vec();
        assert_eq!(inside(&part, 4, 4), inside(&whole, 12, 20), "{c} to {o}");
    }
}

#[test]
fn many_channels_lose_less_than_two_digits() {
    let x = normals(1, &[1, 256, 32, 32]);
    let weight = normals(2, &[64, 256, 3, 3]);
    let error = error(&x, &weight, [1; 4], 131);
    assert!(
        error < 2.5e-6,
        "an error of {error}, where plain sums have about 2e-7"
    );
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    // By bands of several images and of one; by outputs, for want of tiles and for their channels.
    for shape in [
        [2, 64, 47, 33],
        [1, 48, 256, 16],
        [4, 96, 12, 12],
        [1, 140, 40, 36],
    ] {
        let x = pattern(1, &shape);
        let w = pattern(2, &[70, shape[1], 3, 3]);
        let conv = Conv::padded(1);
        let dy = pattern(3, conv2d(&x, &w, None, conv).shape());
        assert_same_bits(&format!("conv {shape:?}"), || {
            let kept = Weight::from(&w).keeping_transforms();
            vec![
                conv2d(&x, &w, None, conv),
                conv2d_finished(&x, &kept, None, conv, Finish::Add(&dy)),
                conv2d_backward_input(&dy, &w, conv, [shape[2], shape[3]]),
            ]
        });
    }
}
