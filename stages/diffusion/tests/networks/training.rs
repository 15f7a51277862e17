//! What training relies on beyond the golden gradients.

use crate::support::{distance, numbers};
use compute::elementwise::{mul, scale, sub};
use compute::reduce::{mean_square, sum};
use compute::{Array, Device};
use diffusion::unet::{Input, TextContext};
use diffusion::{LoraGradients, LoraNetwork, ModelSource, Prior, Unet};

struct Case {
    unet: Unet,
    sample: Array,
    text: Array,
    camera: Array,
}

impl Case {
    fn new() -> Self {
        let unet = Prior::load(&ModelSource::Embedded, &Device::cpu())
            .unwrap()
            .unet;
        let sample = numbers(1, &[2, 19, 5, 6]);
        Self {
            unet,
            sample,
            text: numbers(2, &[2, 77, 32]),
            camera: numbers(3, &[2, 16]),
        }
    }

    fn input<'a>(&'a self, lora: Option<&'a LoraNetwork>, camera: bool) -> Input<'a> {
        let camera = camera.then_some(&self.camera);
        Input {
            sample: &self.sample,
            timesteps: &[500, 20],
            class_labels: &[20, 20],
            lora,
            camera,
        }
    }

    fn forward(&self, lora: Option<&LoraNetwork>, camera: bool) -> Array {
        self.unet
            .forward(&self.input(lora, camera), &self.unet.text(&self.text))
    }

    /// The gradients of the output's mean square.
    fn gradients(&self, lora: &LoraNetwork, camera: bool, sample: bool) -> LoraGradients {
        self.gradients_within(
            usize::MAX,
            &self.input(Some(lora), camera),
            &self.unet.text(&self.text),
            sample,
        )
    }

    fn gradients_within(
        &self,
        budget: usize,
        input: &Input,
        text: &TextContext,
        sample: bool,
    ) -> LoraGradients {
        let (y, tape) = self.unet.forward_train(input, text, budget);
        self.unet
            .backward(input, text, tape, &scale(&y, 2.0 / y.len() as f32), sample)
    }

    /// A LoRA of which no tensor is zero.
    fn trained_lora(&self) -> LoraNetwork {
        let mut lora = self.unet.new_lora(4, 4.0, 7);
        for (i, tensor) in lora
            .adapters
            .values_mut()
            .chain(lora.camera.values_mut())
            .enumerate()
        {
            *tensor = scale(&numbers(100 + i as u64, tensor.shape()), 0.2);
        }
        lora
    }
}

#[test]
fn an_untrained_lora_changes_nothing() {
    let case = Case::new();
    let lora = case.unet.new_lora(4, 8.0, 7);
    assert_eq!(
        case.forward(Some(&lora), true).to_vec(),
        case.forward(None, false).to_vec()
    );
    let down = lora
        .adapters
        .iter()
        .filter(|(name, _)| name.ends_with("lora_A.weight"));
    let (count, square) = down.fold((0, 0.0), |(n, s), (_, a)| (n + 1, s + mean_square(a)));
    assert!(
        count == 56 && (square / count as f32 - 1.0 / 16.0).abs() < 0.004,
        "std of A is not 1/4: {square}"
    );
    assert!(
        lora.adapters["unet.mid_block.attentions.0.transformer_blocks.0.attn1.to_out.0.lora_B.weight"].shape()
            == [128, 4]
    );
}

#[test]
fn camera_gradients_are_slopes_of_the_loss() {
    let case = Case::new();
    let lora = case.trained_lora();
    let gradients = case.gradients(&lora, true, false);
    for (name, gradient) in &gradients.camera {
        let direction = numbers(9, gradient.shape());
        let loss = |step: f32| {
            let mut moved = lora.clone();
            let tensor = &lora.camera[name];
            moved
                .camera
                .insert(name.clone(), sub(tensor, &scale(&direction, -step)));
            f64::from(mean_square(&case.forward(Some(&moved), true)))
        };
        let slope = (loss(3e-3) - loss(-3e-3)) / 6e-3;
        let expected = f64::from(sum(&mul(gradient, &direction)));
        assert!(
            (slope - expected).abs() < 0.01 * expected.abs() + 2e-5,
            "{name}: slope {slope}, gradient {expected}"
        );
    }
}

#[test]
fn the_walk_back_ends_early_with_the_same_gradients() {
    let case = Case::new();
    let lora = case.trained_lora();
    for camera in [false, true] {
        let all = case.gradients(&lora, camera, true);
        let some = case.gradients(&lora, camera, false);
        assert!(all.sample.is_some() && some.sample.is_none());
        assert_eq!(some.camera.is_empty(), !camera);
        assert!(all.adapters.keys().eq(some.adapters.keys()) && all.adapters.len() == 112);
        for (name, gradient) in all.adapters.iter().chain(&all.camera) {
            let other = some.adapters.get(name).or(some.camera.get(name)).unwrap();
            assert_eq!(gradient.to_vec(), other.to_vec(), "{name}");
        }
    }
}

#[test]
fn a_batch_is_its_samples_side_by_side() {
    let case = Case::new();
    let lora = case.trained_lora();
    let both = case.forward(Some(&lora), true);
    let alone = |i: usize| {
        let [sample, text, camera] =
            [&case.sample, &case.text, &case.camera].map(|x| compute::shape::slice(x, 0, i, 1));
        let timesteps = &[[500, 20][i]];
        let lora = Some(&lora);
        let camera = Some(&camera);
        let input = Input {
            sample: &sample,
            timesteps,
            class_labels: &[20],
            lora,
            camera,
        };
        case.unet.forward(&input, &case.unet.text(&text))
    };
    for i in [0, 1] {
        assert!(distance(&compute::shape::slice(&both, 0, i, 1), &alone(i)) < 1e-6);
    }
}

/// Names and bits of all gradients.
fn bits(gradients: &LoraGradients) -> Vec<(String, Vec<u32>)> {
    let named = gradients
        .adapters
        .iter()
        .chain(&gradients.camera)
        .map(|(name, d)| (name.clone(), d));
    let all = named.chain(gradients.sample.iter().map(|d| ("sample".to_owned(), d)));
    all.map(|(name, d)| (name, d.to_vec().into_iter().map(f32::to_bits).collect()))
        .collect()
}

#[test]
fn computing_activations_again_changes_no_bit() {
    let case = Case::new();
    let lora = case.trained_lora();
    let text = case.unet.text(&case.text);
    let within =
        |budget| bits(&case.gradients_within(budget, &case.input(Some(&lora), true), &text, true));
    let all = within(usize::MAX);
    assert_eq!(all.len(), 117);
    for budget in [0, 100_000, 300_000] {
        assert!(within(budget) == all, "with {budget} bytes");
    }
}

#[test]
fn one_text_stands_for_all_samples() {
    let case = Case::new();
    let lora = case.trained_lora();
    let one = compute::shape::slice(&case.text, 0, 0, 1);
    let both = compute::shape::concat(&[&one, &one], 0);
    let [one, both] = [one, both].map(|states| case.unet.text(&states));
    let input = case.input(Some(&lora), true);
    assert_eq!(
        case.unet.forward(&input, &one).to_vec(),
        case.unet.forward(&input, &both).to_vec()
    );
    let [one, both] =
        [one, both].map(|text| case.gradients_within(usize::MAX, &input, &text, false));
    for (name, gradient) in &one.adapters {
        assert!(distance(gradient, &both.adapters[name]) < 1e-5, "{name}");
    }
}

#[test]
fn two_prompts_share_the_way_to_the_first_attention() {
    let case = Case::new();
    let texts = [2, 5].map(|stream| case.unet.text(&numbers(stream, &[1, 77, 32])));
    let input = case.input(None, false);
    let both = case.unet.forward_each(&input, &texts.each_ref());
    for (shared, text) in both.iter().zip(&texts) {
        assert_eq!(shared.to_vec(), case.unet.forward(&input, text).to_vec());
    }
    assert!(distance(&both[0], &both[1]) > 1e-3, "the text has no say");
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let case = Case::new();
    let lora = case.trained_lora();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| bits(&case.gradients(&lora, true, true)))
    };
    assert!(with(1) == with(3));
}

#[test]
fn a_lora_for_another_model_is_refused_by_tensor() {
    let case = Case::new();
    let refusal = |change: &dyn Fn(&mut LoraNetwork)| {
        let mut lora = case.unet.new_lora(4, 4.0, 7);
        change(&mut lora);
        case.unet
            .check_lora(&lora, "lora.safetensors")
            .map_err(|e| e.to_string())
    };
    let name = "unet.mid_block.attentions.0.transformer_blocks.0.attn1.to_q.lora_A.weight";
    assert_eq!(refusal(&|_| {}), Ok(()));
    let shape = refusal(&|lora| {
        drop(
            lora.adapters
                .insert(name.into(), Device::cpu().zeros(&[4, 96])),
        )
    });
    let expected = format!(
        "lora.safetensors: tensor `{name}` has the shape [4, 96]; this model needs [4, 128]"
    );
    assert_eq!(shape, Err(expected));
    let missing = refusal(&|lora| drop(lora.camera.remove("camera_embedding.linear_1.bias")));
    assert_eq!(
        missing,
        Err("lora.safetensors: tensor `camera_embedding.linear_1.bias` is missing".into())
    );
    let extra = refusal(&|lora| drop(lora.adapters.insert("x".into(), Device::cpu().zeros(&[1]))));
    assert_eq!(
        extra,
        Err("lora.safetensors: tensor `x` belongs to no attention of this model".into())
    );
}
