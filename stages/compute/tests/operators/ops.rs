//! The operators that move or reduce values, on examples small enough to read.

use crate::common::pattern;
use compute::{Array, Device, activation, elementwise, reduce, shape};

fn array(shape: &[usize], values: &[f32]) -> Array {
    Device::cpu().array(shape, values.to_vec())
}

#[test]
fn joins_and_cuts() {
    let a = array(&[2, 1, 2], &[1., 2., 3., 4.]);
    let b = array(&[2, 2, 2], &[5., 6., 7., 8., 9., 10., 11., 12.]);
    let joined = shape::concat(&[&a, &b], 1);
    assert_eq!(joined.shape(), [2, 3, 2]);
    assert_eq!(
        joined.to_vec(),
        [1., 2., 5., 6., 7., 8., 3., 4., 9., 10., 11., 12.]
    );
    assert_eq!(shape::slice(&joined, 1, 1, 2).to_vec(), b.to_vec());
    assert_eq!(
        shape::concat(&[&a, &a], 0).to_vec(),
        [1., 2., 3., 4., 1., 2., 3., 4.]
    );
    assert_eq!(
        shape::slice(&joined, 2, 1, 1).to_vec(),
        [2., 6., 8., 4., 10., 12.]
    );
}

#[test]
fn tokens_and_back() {
    let image = pattern(1, &[2, 37, 5, 13]);
    let tokens = shape::nchw_to_tokens(&image);
    assert_eq!(tokens.shape(), [2, 65, 37]);
    let image_values = image.to_vec();
    let token_values = tokens.to_vec();
    assert_eq!(
        token_values[(65 + 7) * 37 + 36],
        image_values[(37 + 36) * 65 + 7]
    );
    assert_eq!(shape::tokens_to_nchw(&tokens, 5, 13).to_vec(), image_values);
}

#[test]
fn enlarges_crops_and_gathers() {
    let image = array(&[1, 1, 1, 2], &[1., 2.]);
    assert_eq!(
        shape::upsample_nearest(&image, 2).to_vec(),
        [1., 1., 2., 2., 1., 1., 2., 2.]
    );
    let image = array(&[1, 1, 3, 3], &[1., 2., 3., 4., 5., 6., 7., 8., 9.]);
    assert_eq!(shape::crop(&image, 1, 0, 2, 2).to_vec(), [4., 5., 7., 8.]);
    let channels = array(
        &[1, 8, 1, 2],
        &(0..16).map(|i| i as f32).collect::<Vec<_>>(),
    );
    let shuffled = shape::pixel_shuffle(&channels, 2);
    assert_eq!(shuffled.shape(), [1, 2, 2, 4]);
    assert_eq!(
        shuffled.to_vec(),
        [
            0., 2., 1., 3., 4., 6., 5., 7., 8., 10., 9., 11., 12., 14., 13., 15.
        ]
    );
    assert_eq!(
        shape::pixel_unshuffle(&shuffled, 2).to_vec(),
        channels.to_vec()
    );
    let odd = pattern(1, &[2, 18, 4, 5]);
    assert_eq!(
        shape::pixel_unshuffle(&shape::pixel_shuffle(&odd, 3), 3).to_vec(),
        odd.to_vec()
    );
    let table = array(&[3, 2], &[1., 2., 3., 4., 5., 6.]);
    let rows = shape::gather_rows(&table, &[2, 0, 2]);
    assert_eq!(
        (rows.shape(), rows.to_vec()),
        ([3, 2].as_slice(), vec![5., 6., 1., 2., 5., 6.])
    );
}

#[test]
fn arithmetic() {
    let x = array(&[3], &[1., -2., 0.]);
    let y = array(&[3], &[4., 5., 6.]);
    assert_eq!(elementwise::add(&x, &y).to_vec(), [5., 3., 6.]);
    assert_eq!(elementwise::sub(&x, &y).to_vec(), [-3., -7., -6.]);
    assert_eq!(elementwise::mul(&x, &y).to_vec(), [4., -10., 0.]);
    assert_eq!(elementwise::offset(&x, 0.5).to_vec(), [1.5, -1.5, 0.5]);
    assert_eq!(elementwise::scale(&x, 3.0).to_vec(), [3., -6., 0.]);
    assert_eq!(elementwise::sign(&x).to_vec(), [1., -1., 0.]);
    assert_eq!(elementwise::clamp(&y, 4.5, 5.5).to_vec(), [4.5, 5., 5.5]);
    let image = array(&[1, 2, 1, 2], &[1., 2., 3., 4.]);
    assert_eq!(
        elementwise::add_channels(&image, &array(&[1, 2], &[10., 20.])).to_vec(),
        [11., 12., 23., 24.]
    );
}

#[test]
fn what_is_below_zero_is_weakened() {
    let x = array(&[1, 2, 1, 3], &[1., -2., 0., -4., 5., -6.]);
    assert_eq!(activation::relu(&x).to_vec(), [1., 0., 0., 0., 5., 0.]);
    assert_eq!(
        activation::leaky_relu(&x, 0.5).to_vec(),
        [1., -1., 0., -2., 5., -3.]
    );
    assert_eq!(
        activation::prelu(&x, &array(&[2], &[0.5, 2.])).to_vec(),
        [1., -1., 0., -8., 5., -12.]
    );
    assert_eq!(
        activation::sigmoid(&array(&[3], &[0., 100., -100.])).to_vec()[..2],
        [0.5, 1.]
    );
}

#[test]
fn reductions_are_exact_where_f32_sums_are_not() {
    let x = Device::cpu().full(&[1000, 1000], 0.1);
    assert_eq!(reduce::mean(&x), 0.1);
    assert_eq!(reduce::sum(&x), 100_000.0);
    let y = array(&[4], &[1., -3., 2., 0.]);
    assert_eq!((reduce::mean_square(&y), reduce::max_abs(&y)), (3.5, 3.0));
}

#[test]
fn a_reshape_shares_and_a_change_does_not() {
    let x = pattern(1, &[4, 3]);
    let y = x.reshape(&[3, 4]);
    let mut state = compute::adam::AdamState::new(&x);
    let mut parameter = x.clone();
    compute::adam::update(&Default::default(), &mut parameter, &x, &mut state, 1);
    assert_eq!(x.to_vec(), y.to_vec());
    assert_ne!(parameter.to_vec(), x.to_vec());
}

#[test]
#[should_panic(expected = "linear: input [2, 3] and weight [5, 4]")]
fn a_wrong_shape_names_the_operator_and_the_shapes() {
    compute::linear::linear(&pattern(1, &[2, 3]), pattern(2, &[5, 4]), None);
}
