//! Arrays longer than a kernel may see at once: every operator gives the bits that it gives where a
//! kernel sees them whole.

use std::sync::{Arc, LazyLock};

use compute::activation::{geglu, geglu_backward, gelu, silu_backward};
use compute::adam::{Adam, AdamState, update};
use compute::attention::{attention, attention_backward};
use compute::conv::{
    Conv, Finish, conv2d, conv2d_backward_input, conv2d_backward_weight, conv2d_finished,
};
use compute::device::attempt;
use compute::elementwise::{add_channels, mul, scaled_sum};
use compute::linear::{linear, linear_backward_input, linear_backward_weight};
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm, layer_norm_backward};
use compute::resize::{Filter, resize, resize_backward};
use compute::shape::{concat, gather_rows, nchw_to_tokens, pad_reflect, slice, upsample_nearest};
use compute::{Array, Device, Format, GpuError, Weight, reduce, testing};

use crate::common::{gpu, pattern, to};

/// 16 KiB: 4096 numbers.
const WINDOW: u64 = 1 << 14;

/// A GPU whose kernels see 4096 numbers of an array at once.
fn narrow() -> Option<&'static Device> {
    static NARROW: LazyLock<Option<Device>> = LazyLock::new(|| testing::weak_gpu(WINDOW));
    NARROW.as_ref()
}

/// Fails unless a GPU that sees little at once computes the bits of one that sees all.
#[track_caller]
fn same(what: &str, inputs: &[Array], compute: impl Fn(&[Array]) -> Vec<Array>) {
    let (Some(wide), Some(narrow)) = (gpu(), narrow()) else {
        return;
    };
    let most = inputs.iter().map(Array::len).max().unwrap_or_default() as u64;
    assert!(
        4 * most > WINDOW,
        "{what}: no input is longer than a window"
    );
    let on = |device| {
        compute(
            &inputs
                .iter()
                .map(|input| to(device, input))
                .collect::<Vec<_>>(),
        )
    };
    for (which, (expected, got)) in on(wide).iter().zip(on(narrow)).enumerate() {
        assert_eq!(got.shape(), expected.shape(), "{what}, result {which}");
        let differs = got
            .to_vec()
            .iter()
            .zip(expected.to_vec())
            .position(|(a, b)| a.to_bits() != b.to_bits());
        assert_eq!(
            differs, None,
            "{what}, result {which} differs from this element on"
        );
    }
}

#[test]
fn products() {
    let inputs = [
        pattern(1, &[130, 70]),
        pattern(2, &[65, 70]),
        pattern(3, &[65]),
        pattern(4, &[130, 65]),
    ];
    same("linear", &inputs, |x| {
        vec![
            linear(&x[0], &x[1], Some(&x[2])),
            linear_backward_input(&x[3], &x[1]),
            linear_backward_weight(&x[0], &x[3]),
        ]
    });
    let conv = Conv {
        stride: 1,
        pad: [1; 4],
    };
    let x = pattern(1, &[1, 9, 31, 33]);
    let weight = pattern(2, &[10, 9, 3, 3]);
    let dy = pattern(3, conv2d(&x, &weight, None, conv).shape());
    same("conv2d", &[x, weight, pattern(4, &[10]), dy], |x| {
        vec![
            conv2d(&x[0], &x[1], Some(&x[2]), conv),
            conv2d_backward_input(&x[3], &x[1], conv, [31, 33]),
            conv2d_backward_weight(&x[0], &x[3], conv, [3, 3]),
            conv2d_finished(&x[0], &x[1], Some(&x[2]), conv, Finish::Add(&x[3])),
        ]
    });
}

#[test]
fn halves_that_a_kernel_names_and_halves_that_it_widens_from_words() {
    let (Some(wide), Some(narrow)) = (gpu(), narrow()) else {
        return;
    };
    let values = pattern(2, &[130, 70]).to_vec();
    let bytes: Vec<u8> = values
        .iter()
        .flat_map(|&v| half::f16::from_f32(v).to_le_bytes())
        .collect();
    let x = pattern(1, &[65, 70]);
    let dy = pattern(3, &[65, 130]);
    let [expected, got] = [wide, narrow].map(|device| {
        let range = 0..bytes.len();
        let weight = Weight::from_bytes(
            device,
            &[130, 70],
            Format::F16,
            Arc::new(bytes.clone()),
            range,
        );
        [
            linear(&to(device, &x), &weight, None),
            linear_backward_input(&to(device, &dy), &weight),
        ]
        .map(|y| y.to_vec())
    });
    assert_eq!(got, expected);
}

#[test]
fn attentions() {
    let inputs = [1, 2, 3, 4].map(|salt| pattern(salt, &[2, 70, 2 * 20]));
    same("attention", &inputs, |x| {
        let attended = attention(&x[0], &x[1], &x[2], 2, false);
        let gradients = attention_backward(&x[0], &x[1], &x[2], &attended, 2, false, &x[3]);
        [attended.out, attended.lse]
            .into_iter()
            .chain(gradients)
            .collect()
    });
}

#[test]
fn norms() {
    let shape = [1, 4, 50, 45];
    same(
        "group_norm",
        &[
            pattern(1, &shape),
            pattern(2, &[4]),
            pattern(3, &[4]),
            pattern(4, &shape),
        ],
        |x| {
            let silu = Activation::Silu;
            vec![
                group_norm(&x[0], &x[1], &x[2], 2, 1e-5, silu),
                group_norm_backward(&x[0], &x[1], &x[2], 2, 1e-5, silu, &x[3]),
            ]
        },
    );
    let shape = [50, 90];
    same(
        "layer_norm",
        &[
            pattern(1, &shape),
            pattern(2, &[90]),
            pattern(3, &[90]),
            pattern(4, &shape),
        ],
        |x| {
            vec![
                layer_norm(&x[0], &x[1], &x[2], 1e-5),
                layer_norm_backward(&x[0], &x[1], 1e-5, &x[3]),
            ]
        },
    );
}

#[test]
fn element_by_element() {
    let shape = [60, 2 * 40];
    same(
        "elementwise",
        &[
            pattern(1, &shape),
            pattern(2, &shape),
            pattern(3, &[60, 40]),
        ],
        |x| {
            let [x, y, half] = [&x[0], &x[1], &x[2]];
            let mut parameter = x.clone();
            let mut state = AdamState::new(x);
            update(&Adam::default(), &mut parameter, y, &mut state, 1);
            let sums = [reduce::sum(x), reduce::mean_square(x), reduce::max_abs(x)];
            vec![
                gelu(x),
                silu_backward(x, y),
                geglu(x),
                geglu_backward(x, half),
                mul(x, y),
                scaled_sum(&[(0.5, x), (2.0, y)]),
                parameter,
                state.v,
                x.device().array(&[3], sums.to_vec()),
            ]
        },
    );
}

#[test]
fn moves_and_resizes() {
    let inputs = [
        pattern(1, &[2, 3, 40, 38]),
        pattern(2, &[2, 3]),
        pattern(3, &[2, 3, 31, 43]),
    ];
    same("moves", &inputs, |x| {
        let [x, numbers, other] = [&x[0], &x[1], &x[2]];
        let tokens = nchw_to_tokens(x);
        vec![
            concat(&[x, x], 1),
            slice(x, 1, 1, 2),
            pad_reflect(x, [3, 2, 1, 0]),
            upsample_nearest(x, 2),
            add_channels(x, numbers),
            gather_rows(tokens.reshape(&[2 * 40 * 38, 3]), &[1, 0, 3039]),
            resize(x, 31, 43, Filter::BicubicTorch, true),
            resize_backward(other, 40, 38, Filter::Lanczos3, true),
            tokens,
        ]
    });
}

#[test]
fn more_pieces_than_a_kernel_has_bindings_are_an_error_that_says_what_to_lower() {
    let Some(device) = testing::weak_gpu(1 << 8) else {
        return;
    };
    let fault = attempt(|| device.full(&[1 << 22], 1.0)).unwrap_err();
    assert!(
        matches!(fault, GpuError::TooLarge { .. }) && fault.to_string().contains("lower the crop"),
        "{fault}"
    );
    assert_eq!(
        attempt(|| device.full(&[100], 2.0).to_vec()),
        Ok(vec![2.0; 100]),
        "the device goes on"
    );
}
