//! The networks of tiny-x4 on a GPU, beside the CPU's: whatever adapter comes first, a software one
//! too. Where there is none the tests pass with a message, unless `SRNERF_REQUIRE_GPU` is set.

use std::sync::LazyLock;

use compute::elementwise::scale;
use compute::{Array, Counts, Device, testing};
use diffusion::unet::Input;
use diffusion::{LoraNetwork, ModelSource, Prior};

use crate::support::{distance, numbers};

const TOLERANCE: f64 = 1e-4;

/// tiny-x4 on a device.
struct Tiny {
    device: Device,
    prior: Prior,
}

impl Tiny {
    fn new(device: Device) -> Self {
        Self {
            prior: Prior::load(&ModelSource::Embedded, &device).unwrap(),
            device,
        }
    }

    /// The numbers of a stream.
    fn numbers(&self, stream: u64, shape: &[usize]) -> Array {
        self.device.array(shape, numbers(stream, shape).to_vec())
    }
}

/// tiny-x4 on the CPU and on the first adapter.
fn pair() -> Option<&'static [Tiny; 2]> {
    static PAIR: LazyLock<Option<[Tiny; 2]>> =
        LazyLock::new(|| Some([Tiny::new(Device::cpu()), Tiny::new(testing::gpu()?)]));
    PAIR.as_ref()
}

/// Fails unless both devices compute the same.
#[track_caller]
fn agree(what: &str, compute: impl Fn(&Tiny) -> Array) {
    let Some([cpu, gpu]) = pair() else { return };
    let expected = compute(cpu);
    let got = compute(gpu);
    assert!(got.device().is_gpu(), "{what} left the GPU");
    let off = distance(&got, &expected);
    assert!(off < TOLERANCE, "{what} is off by {off:.1e} of its norm");
}

fn input<'a>(
    sample: &'a Array,
    lora: Option<&'a LoraNetwork>,
    camera: Option<&'a Array>,
) -> Input<'a> {
    Input {
        sample,
        timesteps: &[500, 20],
        class_labels: &[20, 3],
        lora,
        camera,
    }
}

fn forward(tiny: &Tiny, size: [usize; 2]) -> Array {
    let sample = tiny.numbers(1, &[2, 19, size[0], size[1]]);
    tiny.prior.unet.forward(
        &input(&sample, None, None),
        &tiny.prior.unet.text(&tiny.numbers(2, &[2, 77, 32])),
    )
}

#[test]
fn the_networks_compute_what_they_do_on_the_cpu() {
    agree("the text", |tiny| {
        tiny.prior
            .text(&["high resolution, 4K, photo", "blurry, low quality"])
    });
    agree("the UNet", |tiny| forward(tiny, [12, 16]));
    agree("the UNet, at an odd size", |tiny| forward(tiny, [11, 15]));
    agree("the encoder", |tiny| {
        tiny.prior
            .vae
            .encode(&tiny.numbers(3, &[1, 3, 40, 32]))
            .mean
    });
    agree("the decoder", |tiny| {
        tiny.prior.vae.decode(&tiny.numbers(4, &[1, 16, 10, 8]))
    });
    agree("the decoder, by tiles", |tiny| {
        tiny.prior
            .vae
            .decode_latent(&tiny.numbers(5, &[1, 16, 20, 12]), [80, 48], 16)
    });
}

/// A LoRA of which no tensor is zero.
fn lora(tiny: &Tiny) -> LoraNetwork {
    let mut lora = tiny.prior.unet.new_lora(4, 4.0, 7);
    for (stream, tensor) in (100..).zip(lora.adapters.values_mut().chain(lora.camera.values_mut()))
    {
        *tensor = scale(&tiny.numbers(stream, tensor.shape()), 0.2);
    }
    lora
}

#[test]
fn gradients_of_a_lora_are_those_of_the_cpu() {
    let Some(pair) = pair() else { return };
    let [cpu, gpu] = pair.each_ref().map(|tiny| {
        let sample = tiny.numbers(1, &[2, 19, 6, 7]);
        let camera = tiny.numbers(3, &[2, 16]);
        let lora = lora(tiny);
        let input = input(&sample, Some(&lora), Some(&camera));
        let text = tiny.prior.unet.text(&tiny.numbers(2, &[2, 77, 32]));
        // Some layers keep what they need, others compute it again.
        let (y, tape) = tiny.prior.unet.forward_train(&input, &text, 1 << 20);
        tiny.prior
            .unet
            .backward(&input, &text, tape, &scale(&y, 2.0 / y.len() as f32), true)
    });
    let sample = [&cpu, &gpu].map(|gradients| gradients.sample.as_ref().unwrap());
    assert!(distance(sample[1], sample[0]) < TOLERANCE, "by the sample");
    let tensors = cpu
        .adapters
        .iter()
        .chain(&cpu.camera)
        .zip(gpu.adapters.values().chain(gpu.camera.values()));
    for ((name, expected), got) in tensors {
        let off = distance(got, expected);
        assert!(off < TOLERANCE, "{name} is off by {off:.1e} of its norm");
    }
}

#[test]
fn a_gpu_that_sees_little_of_an_array_at_once_decodes_to_the_same_bits() {
    let Some([_, wide]) = pair() else { return };
    // The decoder's largest arrays are 1 MiB each.
    let Some(device) = testing::weak_gpu(1 << 18) else {
        return;
    };
    let decode = |tiny: &Tiny| {
        tiny.prior
            .vae
            .decode(&tiny.numbers(4, &[1, 16, 12, 14]))
            .to_vec()
    };
    assert!(decode(&Tiny::new(device)) == decode(wide));
}

#[test]
fn a_pass_costs_no_more_than_it_did() {
    // A device of its own, since it counts.
    let Some(device) = testing::gpu() else { return };
    let tiny = Tiny::new(device);
    let counts = |pass: &dyn Fn() -> Array| {
        pass().to_vec();
        let before = tiny.device.counts().unwrap();
        pass().to_vec();
        tiny.device.counts().unwrap() - before
    };
    let unet = counts(&|| forward(&tiny, [8, 8]));
    let expected = Counts {
        dispatches: 342,
        submissions: 2,
        read_backs: 1,
        operations: 281_238_016,
        bytes: 36_168_648,
        uploaded: 29_960,
        pipelines: 0,
    };
    assert_eq!(unet, expected, "a pass through the UNet");
}
