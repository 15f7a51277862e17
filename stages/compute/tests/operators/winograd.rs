//! Convolutions large enough for Winograd's filtering, against sums in `f64`.

use compute::conv::{Conv, conv2d, conv2d_backward_input};
use compute::{Array, Device, Rng};
use proptest::prelude::*;

use crate::common::{assert_adjoint, dot};

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
    let (values, kernels) = (input.to_vec(), weight.to_vec());
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

/// Independent numbers. `pattern`'s are not: at some widths the channels' products cancel, and an error relative to
/// what is left of them says little.
fn normals(salt: u64, shape: &[usize]) -> Array {
    Rng::new(salt, "winograd").normals(0, shape, &Device::cpu())
}

/// The norm of the error over the norm of the result, over every `step`-th output.
fn error(input: &Array, weight: &Array, pad: [usize; 4], step: usize) -> f64 {
    let y = conv2d(input, weight, None, Conv { stride: 1, pad });
    let &[_, o, h, w] = y.shape() else {
        panic!("four axes")
    };
    let (mut difference, mut size) = (0.0, 0.0);
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
        let (x, weight) = (normals(1, &[n, c, h, w]), normals(2, &[o, c, 3, 3]));
        prop_assert!(error(&x, &weight, pad, 97) < 1.5e-6);
        let conv = Conv { stride: 1, pad };
        let y = conv2d(&x, &weight, None, conv);
        let dy = normals(3, y.shape());
        assert_adjoint("input", &y, &dy, dot(&x, &conv2d_backward_input(&dy, &weight, conv, [h, w])));
    }
}

#[test]
fn many_channels_lose_less_than_two_digits() {
    let (x, weight) = (normals(1, &[1, 256, 32, 32]), normals(2, &[64, 256, 3, 3]));
    let error = error(&x, &weight, [1; 4], 131);
    assert!(
        error < 2.5e-6,
        "an error of {error}, where plain sums have about 2e-7"
    );
}
