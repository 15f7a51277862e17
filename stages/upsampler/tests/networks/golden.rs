//! Every family against PyTorch's numbers, written by reference/networks.py; on the CPU and on a
//! GPU.

use compute::{Device, testing};
use upsampler::{Options, Upsampler, UpsamplerSource};

use crate::support::{asked, furthest, load, picture};

const TOLERANCE: f32 = 1e-4;

/// Files, families and scales.
const CASES: [(&str, &str, usize); 14] = [
    ("residual-x4.safetensors", "Residual", 4),
    ("compact-x4.safetensors", "SRVGGNetCompact", 4),
    ("compact-x2.safetensors", "SRVGGNetCompact", 2),
    ("compact-x1.safetensors", "SRVGGNetCompact", 1),
    ("rrdb-x4.safetensors", "RRDBNet", 4),
    ("rrdb-x2.safetensors", "RRDBNet", 2),
    ("rrdb-x1.safetensors", "RRDBNet", 1),
    ("rrdb-x4-old.safetensors", "RRDBNet", 4),
    ("span-x4.safetensors", "SPAN", 4),
    ("span-x2.safetensors", "SPAN", 2),
    ("ncnn-span-f16.param", "ncnn graph", 4),
    ("ncnn-span-f32.param", "ncnn graph", 4),
    ("ncnn-compact-f16.bin", "ncnn graph", 2),
    ("ncnn-compact-f32.bin", "ncnn graph", 2),
];

fn agree(device: &Device) {
    for (name, family, scale) in CASES {
        let network = load(name, device);
        let about = network.inventory();
        assert_eq!(
            (about.family, about.scale, network.scale()),
            (family, scale, scale),
            "{name}"
        );
        let [sample, expected] = asked(name, device);
        let error = furthest(&network.enlarge(&sample, Options::default()), &expected);
        assert!(error < TOLERANCE, "{name}: {error:.1e} from PyTorch's");
    }
}

#[test]
fn the_families_are_pytorchs() {
    agree(&Device::cpu());
}

#[test]
fn on_a_gpu_they_are_the_same() {
    let Some(gpu) = testing::gpu() else { return };
    agree(&gpu);
    let cpu = Upsampler::load(&UpsamplerSource::Embedded, &Device::cpu()).unwrap();
    let other = Upsampler::load(&UpsamplerSource::Embedded, &gpu).unwrap();
    let options = Options {
        tile: 128,
        ensemble: false,
    };
    let expected = cpu.enlarge(&picture(40, 150, &Device::cpu()), options);
    let got = other.enlarge(&picture(40, 150, &gpu), options);
    assert!(got.device().is_gpu() && furthest(&got, &expected) < TOLERANCE);
}

#[test]
fn what_a_network_is_made_of_is_told() {
    let about = load("span-x4.safetensors", &Device::cpu()).inventory();
    assert_eq!(
        (about.width, &about.depth[..], about.reach, about.margin),
        (6, "6 blocks", 21, 24)
    );
    assert_eq!(about.types.keys().collect::<Vec<_>>(), ["F16", "F32"]);
    let graph = load("ncnn-span-f16.param", &Device::cpu()).inventory();
    assert_eq!(
        (graph.width, &graph.depth[..], graph.reach),
        (48, "22 convolutions", 21)
    );
    let halves = graph.types["F16"];
    // Twenty 3x3 convolutions of the width, the first, the one of single pixels, and the last.
    assert_eq!(halves, 19 * 6 * 6 * 9 + 6 * 3 * 9 + 6 * 24 + 48 * 6 * 9);
    assert_eq!(graph.parameters, halves + graph.types["F32"]);
}
