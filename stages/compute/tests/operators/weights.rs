//! Weights kept in 16 bits or in foreign bytes act as the arrays they widen to, to the bit.

use std::sync::Arc;

use crate::common::pattern;
use compute::conv::{Conv, conv2d, conv2d_backward_input};
use compute::linear::{linear, linear_backward_input};
use compute::shape::gather_rows;
use compute::{Array, Device, Format, Weight};

/// A pattern stored in `format`, three bytes into foreign bytes so that it lies at an odd address.
fn stored(format: Format, shape: &[usize]) -> Weight {
    let values = pattern(1, shape).to_vec();
    let encoded = values.iter().flat_map(|value| match format {
        Format::F32 => value.to_le_bytes().to_vec(),
        Format::F16 => half::f16::from_f32(*value).to_le_bytes().to_vec(),
        Format::Bf16 => half::bf16::from_f32(*value).to_le_bytes().to_vec(),
    });
    let bytes: Vec<u8> = [1, 2, 3].into_iter().chain(encoded).collect();
    let range = 3..bytes.len();
    Weight::from_bytes(&Device::cpu(), shape, format, Arc::new(bytes), range)
}

fn bits(array: &Array) -> Vec<u32> {
    array.to_vec().iter().map(|value| value.to_bits()).collect()
}

#[test]
fn operators_widen_as_to_array_does() {
    for format in [Format::F32, Format::F16, Format::Bf16] {
        for (rows, m, k) in [(1, 5, 3), (70, 130, 300), (40, 7, 600)] {
            let weight = stored(format, &[m, k]);
            let x = pattern(2, &[rows, k]);
            let dy = pattern(3, &[rows, m]);
            let wide = weight.to_array();
            assert_eq!(
                bits(&linear(&x, &weight, None)),
                bits(&linear(&x, &wide, None)),
                "{format:?}"
            );
            let [narrow, wide] = [
                linear_backward_input(&dy, &weight),
                linear_backward_input(&dy, &wide),
            ];
            assert_eq!(bits(&narrow), bits(&wide), "{format:?}");
        }
        for (c, o, kernel, stride, size) in [
            (3, 5, 3, 1, 9),
            (40, 33, 3, 1, 24),
            (17, 20, 1, 1, 13),
            (9, 20, 3, 2, 21),
            (64, 50, 3, 1, 24),
        ] {
            let weight = stored(format, &[o, c, kernel, kernel]);
            let wide = weight.to_array();
            let conv = Conv {
                stride,
                pad: [kernel / 2; 4],
            };
            let x = pattern(2, &[2, c, size, size]);
            let y = conv2d(&x, &wide, None, conv);
            assert_eq!(
                bits(&conv2d(&x, &weight, None, conv)),
                bits(&y),
                "{format:?}"
            );
            let back = |weight: &Weight| conv2d_backward_input(&y, weight, conv, [size; 2]);
            assert_eq!(
                bits(&back(&weight)),
                bits(&back(&wide.into())),
                "{format:?}"
            );
        }
        let table = stored(format, &[6, 5]);
        assert_eq!(
            bits(&gather_rows(&table, &[4, 0, 4])),
            bits(&gather_rows(table.to_array(), &[4, 0, 4]))
        );
    }
}

#[test]
#[should_panic(expected = "weight: 0..8 does not fill the shape [2, 3] of F16")]
fn bytes_that_do_not_fill_the_shape_are_refused() {
    Weight::from_bytes(
        &Device::cpu(),
        &[2, 3],
        Format::F16,
        Arc::new(vec![0; 8]),
        0..8,
    );
}
