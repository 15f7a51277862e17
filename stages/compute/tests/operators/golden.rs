//! The operators against PyTorch and Pillow: the numbers in `golden/golden.json`, written by
//! `golden/generate.py`.

use std::collections::BTreeMap;

use crate::common::{assert_close, pattern};
use compute::adam::{Adam, AdamState, update};
use compute::conv::{Conv, conv2d, conv2d_backward_input, conv2d_backward_weight};
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm, layer_norm_backward};
use compute::resize::{Filter, resize};
use compute::{Array, Device, activation, attention, elementwise, shape};

struct Golden(BTreeMap<String, serde_json::Value>);

impl Golden {
    fn load() -> Golden {
        Golden(
            serde_json::from_str(include_str!("golden/golden.json")).expect("golden.json parses"),
        )
    }

    fn get(&self, name: &str) -> Array {
        let list = |key: &str| self.0[name][key].as_array().expect("a list");
        let shape: Vec<usize> = list("shape")
            .iter()
            .map(|extent| extent.as_u64().expect("an extent") as usize)
            .collect();
        Device::cpu().array(
            &shape,
            list("values")
                .iter()
                .map(|value| value.as_f64().expect("a number") as f32)
                .collect(),
        )
    }

    #[track_caller]
    fn check(&self, name: &str, got: &Array) {
        assert_close(name, got, &self.get(name), 3e-6);
    }

    /// PyTorch rounds the position of a resampled pixel to f32, which costs it a digit; ours is
    /// f64.
    #[track_caller]
    fn check_resized(&self, name: &str, got: &Array) {
        assert_close(name, got, &self.get(&format!("resize.{name}")), 1e-5);
    }
}

#[test]
fn convolutions_are_torchs() {
    let golden = Golden::load();
    let x = pattern(1, &[2, 3, 9, 7]);
    let w = pattern(2, &[4, 3, 3, 3]);
    let b = pattern(3, &[4]);
    for (name, stride, pad) in [
        ("plain", 1, [1; 4]),
        ("strided", 2, [0, 1, 0, 1]),
        ("uneven", 1, [0, 2, 1, 0]),
    ] {
        let conv = Conv { stride, pad };
        let y = conv2d(&x, &w, Some(&b), conv);
        let dy = pattern(4, y.shape());
        golden.check(&format!("conv.{name}"), &y);
        golden.check(
            &format!("conv.{name}.dx"),
            &conv2d_backward_input(&dy, &w, conv, [9, 7]),
        );
        golden.check(
            &format!("conv.{name}.dw"),
            &conv2d_backward_weight(&x, &dy, conv, [3, 3]),
        );
    }
}

#[test]
fn norms_are_torchs() {
    let golden = Golden::load();
    let x = pattern(5, &[2, 6, 5, 3]);
    let gamma = pattern(6, &[6]);
    let beta = pattern(7, &[6]);
    let dy = pattern(8, x.shape());
    for (name, act) in [("plain", Activation::None), ("silu", Activation::Silu)] {
        golden.check(
            &format!("group_norm.{name}"),
            &group_norm(&x, &gamma, &beta, 3, 1e-5, act),
        );
        let dx = group_norm_backward(&x, &gamma, &beta, 3, 1e-5, act, &dy);
        golden.check(&format!("group_norm.{name}.dx"), &dx);
    }
    let x = pattern(5, &[3, 37]);
    let gamma = pattern(6, &[37]);
    let beta = pattern(7, &[37]);
    golden.check("layer_norm", &layer_norm(&x, &gamma, &beta, 1e-5));
    golden.check(
        "layer_norm.dx",
        &layer_norm_backward(&x, &gamma, 1e-5, &pattern(8, x.shape())),
    );
}

#[test]
fn attention_is_torchs() {
    let golden = Golden::load();
    let q = elementwise::scale(&pattern(9, &[2, 67, 6]), 4.0);
    for (name, keys, causal) in [
        ("full", 67, false),
        ("cross", 5, false),
        ("causal", 67, true),
    ] {
        let k = pattern(10, &[2, keys, 6]);
        let v = pattern(11, &[2, keys, 6]);
        let attended = attention::attention(&q, &k, &v, 2, causal);
        golden.check(&format!("attention.{name}"), &attended.out);
        let dout = pattern(12, q.shape());
        let gradients = attention::attention_backward(&q, &k, &v, &attended, 2, causal, &dout);
        for (input, gradient) in ["dq", "dk", "dv"].iter().zip(&gradients) {
            golden.check(&format!("attention.{name}.{input}"), gradient);
        }
    }
}

#[test]
fn activations_are_torchs() {
    let golden = Golden::load();
    let x = elementwise::scale(&pattern(13, &[100]), 6.0);
    let dy = pattern(14, &[100]);
    type Forward = fn(&Array) -> Array;
    type Backward = fn(&Array, &Array) -> Array;
    let functions: [(&str, Forward, Backward); 3] = [
        ("silu", activation::silu, activation::silu_backward),
        ("gelu", activation::gelu, activation::gelu_backward),
        (
            "quick_gelu",
            activation::quick_gelu,
            activation::quick_gelu_backward,
        ),
    ];
    for (name, forward, backward) in functions {
        golden.check(name, &forward(&x));
        golden.check(&format!("{name}.dx"), &backward(&x, &dy));
    }
    let x = elementwise::scale(&pattern(13, &[5, 22]), 3.0);
    golden.check("geglu", &activation::geglu(&x));
    golden.check(
        "geglu.dx",
        &activation::geglu_backward(&x, &pattern(14, &[5, 11])),
    );
}

#[test]
fn resizing_is_torchs() {
    let golden = Golden::load();
    let small = [9, 13];
    let large = [47, 63];
    let cases = [
        ("bicubic_torch_up", small, Filter::BicubicTorch, false),
        ("bicubic_torch_down", large, Filter::BicubicTorch, false),
        (
            "bicubic_torch_antialias_down",
            large,
            Filter::BicubicTorch,
            true,
        ),
        ("bilinear_up", small, Filter::Bilinear, false),
        ("bilinear_antialias_down", large, Filter::Bilinear, true),
        ("nearest_up", small, Filter::Nearest, false),
        ("nearest_down", large, Filter::Nearest, false),
        ("area_down", large, Filter::Area, false),
    ];
    for (name, [h, w], filter, antialias) in cases {
        let [height, width] = if h == 9 { [36, 52] } else { [12, 16] };
        let y = resize(
            &pattern(15, &[1, 1, h, w]),
            height,
            width,
            filter,
            antialias,
        );
        golden.check_resized(name, &y);
    }
}

#[test]
fn resizing_is_pillows() {
    let golden = Golden::load();
    let cases = [
        ("bicubic_pil_down", [47, 63], [12, 16], Filter::BicubicPil),
        ("bicubic_pil_up", [9, 13], [36, 52], Filter::BicubicPil),
        ("lanczos_down", [47, 63], [12, 16], Filter::Lanczos3),
        ("lanczos_up", [9, 13], [36, 52], Filter::Lanczos3),
        ("bilinear_pil_down", [47, 63], [12, 16], Filter::Bilinear),
    ];
    for (name, [h, w], [height, width], filter) in cases {
        golden.check_resized(
            name,
            &resize(&pattern(15, &[1, 1, h, w]), height, width, filter, true),
        );
    }
}

#[test]
fn reflection_is_torchs() {
    let padded = shape::pad_reflect(&pattern(17, &[1, 2, 4, 5]), [2, 1, 3, 4]);
    Golden::load().check("pad_reflect", &padded);
}

#[test]
fn adam_is_torchs() {
    for (name, weight_decay) in [("adam", 0.0), ("adamw", 0.1)] {
        let adam = Adam {
            rate: 0.01,
            beta2: 0.99,
            weight_decay,
            ..Adam::default()
        };
        let mut parameter = pattern(18, &[9]);
        let mut state = AdamState::new(&parameter);
        for step in 0..3 {
            update(
                &adam,
                &mut parameter,
                &pattern(19 + step, &[9]),
                &mut state,
                step + 1,
            );
        }
        Golden::load().check(name, &parameter);
    }
}
