//! Moves on examples small enough to read, and on a GPU.

use proptest::prelude::*;

use super::*;
use crate::check::{
    agree, assert_adjoint, assert_same_bits, bits, check_golden, dot, pattern, stored,
};
use crate::{Device, Format};

fn array(shape: &[usize], values: &[f32]) -> Array {
    Device::cpu().array(shape, values.to_vec())
}

#[test]
fn joins_and_cuts() {
    let a = array(&[2, 1, 2], &[1., 2., 3., 4.]);
    let b = array(&[2, 2, 2], &[5., 6., 7., 8., 9., 10., 11., 12.]);
    let joined = concat(&[&a, &b], 1);
    assert_eq!(joined.shape(), [2, 3, 2]);
    assert_eq!(
        joined.to_vec(),
        [1., 2., 5., 6., 7., 8., 3., 4., 9., 10., 11., 12.]
    );
    assert_eq!(slice(&joined, 1, 1, 2).to_vec(), b.to_vec());
    assert_eq!(
        concat(&[&a, &a], 0).to_vec(),
        [1., 2., 3., 4., 1., 2., 3., 4.]
    );
    assert_eq!(slice(&joined, 2, 1, 1).to_vec(), [2., 6., 8., 4., 10., 12.]);
}

#[test]
fn tokens_and_back() {
    let image = pattern(1, &[2, 37, 5, 13]);
    let tokens = nchw_to_tokens(&image);
    assert_eq!(tokens.shape(), [2, 65, 37]);
    let image_values = image.to_vec();
    let token_values = tokens.to_vec();
    assert_eq!(
        token_values[(65 + 7) * 37 + 36],
        image_values[(37 + 36) * 65 + 7]
    );
    assert_eq!(tokens_to_nchw(&tokens, 5, 13).to_vec(), image_values);
}

#[test]
fn enlarges_crops_and_gathers() {
    let image = array(&[1, 1, 1, 2], &[1., 2.]);
    assert_eq!(
        upsample_nearest(&image, 2).to_vec(),
        [1., 1., 2., 2., 1., 1., 2., 2.]
    );
    let image = array(&[1, 1, 3, 3], &[1., 2., 3., 4., 5., 6., 7., 8., 9.]);
    assert_eq!(crop(&image, 1, 0, 2, 2).to_vec(), [4., 5., 7., 8.]);
    let channels = array(
        &[1, 8, 1, 2],
        &(0..16).map(|i| i as f32).collect::<Vec<_>>(),
    );
    let shuffled = pixel_shuffle(&channels, 2);
    assert_eq!(shuffled.shape(), [1, 2, 2, 4]);
    assert_eq!(
        shuffled.to_vec(),
        [
            0., 2., 1., 3., 4., 6., 5., 7., 8., 10., 9., 11., 12., 14., 13., 15.
        ]
    );
    assert_eq!(pixel_unshuffle(&shuffled, 2).to_vec(), channels.to_vec());
    let odd = pattern(1, &[2, 18, 4, 5]);
    assert_eq!(
        pixel_unshuffle(&pixel_shuffle(&odd, 3), 3).to_vec(),
        odd.to_vec()
    );
    let table = array(&[3, 2], &[1., 2., 3., 4., 5., 6.]);
    let rows = gather_rows(&table, &[2, 0, 2]);
    assert_eq!(
        (rows.shape(), rows.to_vec()),
        ([3, 2].as_slice(), vec![5., 6., 1., 2., 5., 6.])
    );
}

#[test]
fn upsampling_has_an_adjoint() {
    for factor in [1, 2, 3] {
        let x = pattern(1, &[2, 3, 5, 7]);
        let y = upsample_nearest(&x, factor);
        let dy = pattern(2, y.shape());
        let back = upsample_nearest_backward(&dy, factor);
        assert_adjoint("upsample_nearest", &y, &dy, dot(&x, &back));
    }
}

#[test]
fn reflection_is_torchs() {
    let padded = pad_reflect(&pattern(17, &[1, 2, 4, 5]), [2, 1, 3, 4]);
    check_golden("pad_reflect", &padded);
}

#[test]
fn a_table_in_16_bits_acts_as_what_it_widens_to() {
    for format in [Format::F32, Format::F16, Format::Bf16] {
        let table = stored(format, &[6, 5]);
        assert_eq!(
            bits(&gather_rows(&table, &[4, 0, 4])),
            bits(&gather_rows(table.to_array(), &[4, 0, 4]))
        );
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let x = pattern(1, &[2, 3, 130, 129]);
    assert_same_bits("tokens", || vec![nchw_to_tokens(&x)]);
}

/// What a GPU gives beside the CPU. Skipped where there is no adapter.
mod on_a_gpu {
    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 21))]

        #[test]
        fn moves(
            (n, c, h, w) in (1usize..4, 1usize..40, 2usize..20, 2usize..40),
            factor in 1usize..4,
        ) {
            let pad = [1, h - 1, w - 1, 0];
            let inputs = [pattern(1, &[n, c, h, w]), pattern(2, &[n, c, h * factor, w * factor])];
            agree("moves", &inputs, |x| {
                let tokens = nchw_to_tokens(&x[0]);
                vec![
                    tokens_to_nchw(&tokens, h, w), tokens.clone(),
                    concat(&[&x[0], &x[0], &x[0]], 1), concat(&[&x[0], &x[0]], 0),
                    slice(&x[0], 1, c / 2, c - c / 2), crop(&x[0], 1, w / 2, h - 1, w - w / 2),
                    pad_reflect(&x[0], pad),
                    upsample_nearest(&x[0], factor), upsample_nearest_backward(&x[1], factor),
                    gather_rows(tokens.reshape(&[n * h * w, c]), &[1, 0, (n * h * w - 1) as u32]),
                    pixel_shuffle(&concat(&vec![&x[0]; factor * factor], 1), factor),
                    pixel_unshuffle(&x[1], factor),
                ]
            });
        }
    }
}
