//! LPIPS and ST-LPIPS against the packages `lpips` and `stlpips-pytorch`, with weights that both
//! make by one rule (`golden/lpips.py`); and what becomes of files that are not theirs.

#![allow(clippy::unwrap_used)] // the helpers of tests are tests too

use std::collections::BTreeMap;
use std::path::PathBuf;

use formats::tensor_file::to_bytes;
use formats::{FileBytes, TensorView, Values};
use metrics::{Image, Lpips};
use serde_json::Value;

const WIDTH: usize = 96;
const HEIGHT: usize = 80;

/// The picture that `texture` of `pictures.py` draws.
fn truth() -> Vec<usize> {
    let value = |x: usize, y: usize, c: usize| match x < WIDTH / 2 && y < HEIGHT / 2 {
        true => 200,
        false => {
            (x * x / 64 + y * 3 + c * 40) % 128
                + (x * 7919 + y * 104_729 + c * 1_299_709 + x * y * 31) % 97
        }
    };
    let places = 0..WIDTH * HEIGHT * 3;
    places
        .map(|i| value(i / 3 % WIDTH, i / 3 / WIDTH, i % 3))
        .collect()
}

/// The picture that `degraded` of `pictures.py` makes of it.
fn degraded(truth: &[usize]) -> Vec<usize> {
    let at = |x: usize, y: usize, c: usize| truth[(y * WIDTH + x) * 3 + c];
    let value = |x: usize, y: usize, c: usize| {
        (at(x, y, c) + at((x + WIDTH - 1) % WIDTH, y, c)) / 2 * 9 / 10 / 8 * 8
    };
    let places = 0..truth.len();
    places
        .map(|i| value(i / 3 % WIDTH, i / 3 / WIDTH, i % 3))
        .collect()
}

fn floats(rgb8: &[usize]) -> Vec<f32> {
    rgb8.iter().map(|&value| value as f32 / 255.0).collect()
}

/// The weights that `filled` of `lpips.py` gives a tensor.
fn filled(number: usize, name: &str, shape: &[usize]) -> Vec<f32> {
    let fan_in: usize = shape[1..].iter().product();
    let value = |i: usize| {
        let part = ((i * i % 10_007 * 7919 + i * 104_729 + number * 1_299_709) % 10_007) as f64;
        let part = part / 10_007.0;
        let value = match name {
            name if name.starts_with("lin") => part,
            name if name.ends_with("bias") => (part - 0.5) * 0.2,
            _ => (part - 0.5) * (24.0 / fan_in as f64).sqrt(),
        };
        value as f32
    };
    (0..shape.iter().product()).map(value).collect()
}

/// The state of a network, without the tensors that `left_out` says, as a file.
fn file(network: &Value, left_out: impl Fn(&str) -> bool) -> FileBytes {
    let tensors = network["tensors"].as_array().unwrap().iter().enumerate();
    let tensors: Vec<(&str, Vec<usize>, Vec<f32>)> = tensors
        .map(|(number, tensor)| {
            let name = tensor[0].as_str().unwrap();
            let shape = tensor[1].as_array().unwrap().iter();
            let shape: Vec<usize> = shape.map(|x| x.as_u64().unwrap() as usize).collect();
            let values = filled(number, name, &shape);
            (name, shape, values)
        })
        .collect();
    let kept = tensors.iter().filter(|(name, ..)| !left_out(name));
    let views: BTreeMap<&str, TensorView> = kept
        .map(|(name, shape, values)| {
            let values = Values::F32(values);
            (*name, TensorView { shape, values })
        })
        .collect();
    let bytes = to_bytes(&views, &BTreeMap::new()).unwrap();
    FileBytes::in_memory("made.safetensors", bytes)
}

fn golden() -> Value {
    serde_json::from_str(include_str!("golden/lpips.json")).unwrap()
}

#[test]
fn distances_are_those_of_the_packages() {
    let truth = truth();
    let image = floats(&degraded(&truth));
    let truth = floats(&truth);
    let truth = Image::new(WIDTH, HEIGHT, &truth);
    let image = Image::new(WIDTH, HEIGHT, &image);
    for (name, network) in golden().as_object().unwrap() {
        let lpips = Lpips::open(file(network, |_| false)).unwrap();
        assert_eq!(lpips.name(), name);
        let distance = lpips.distance(truth, image).unwrap();
        let expected = network["distance"].as_f64().unwrap();
        assert!(
            (distance - expected).abs() < 1e-5,
            "{name}: {distance} instead of {expected}"
        );
        assert_eq!(lpips.distance(truth, truth), Some(0.0));
    }
}

/// With the weights that the wheel `stlpips-pytorch` carries, in a folder that `golden/lpips.py` fills.
#[test]
fn trained_weights_give_the_package_s_distances() {
    let Some(folder) = std::env::var_os("SRNERF_TEST_STLPIPS").map(PathBuf::from) else {
        eprintln!(
            "SRNERF_TEST_STLPIPS names no folder with ST-LPIPS's trained weights: not tested"
        );
        return;
    };
    let truth = truth();
    let image = floats(&degraded(&truth));
    let truth = floats(&truth);
    let truth = Image::new(WIDTH, HEIGHT, &truth);
    let image = Image::new(WIDTH, HEIGHT, &image);
    for name in ["stlpips_alex", "stlpips_vgg"] {
        let file = FileBytes::map(&folder.join(format!("{name}.safetensors"))).unwrap();
        let distance = Lpips::open(file).unwrap().distance(truth, image).unwrap();
        let expected = golden()[name]["trained"].as_f64().unwrap();
        assert!(
            (distance - expected).abs() < 1e-5,
            "{name}: {distance} instead of {expected}"
        );
    }
}

#[test]
fn other_files_are_refused_by_tensor() {
    let golden = golden();
    let alex = &golden["lpips_alex"];
    let error = |left_out: &str| {
        let opened = Lpips::open(file(alex, |name| name.starts_with(left_out)));
        opened.err().unwrap().to_string()
    };
    assert_eq!(
        error("lin3"),
        "made.safetensors: tensor `lin3.model.1.weight` is missing"
    );
    assert!(error("net.").starts_with("made.safetensors: holds no LPIPS network"));
}

#[test]
fn a_picture_too_small_for_the_trunk_has_no_distance() {
    let lpips = Lpips::open(file(&golden()["lpips_alex"], |_| false)).unwrap();
    let rgb = [0.5; 31 * 40 * 3];
    let small = Image::new(31, 40, &rgb);
    assert_eq!(lpips.distance(small, small), None);
}
