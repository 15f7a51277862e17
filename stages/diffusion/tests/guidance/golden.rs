//! Ten guidance steps with tiny-x4 against PyTorch: `../golden/guidance.py` makes the same draws
//! and writes `guidance.json`.

use std::collections::BTreeMap;

use compute::{Device, Rng};
use diffusion::guidance::{Guidance, Rsd, Sds, Vsd};
use diffusion::optimize::{LoraState, Optimization, Options, State, StepLog, ViewLatents};
use diffusion::{ModelSource, Prior};

const SEED: u64 = 3;

fn views() -> Vec<ViewLatents> {
    let device = Device::cpu();
    let normals =
        |domain, view, shape: &[usize]| Rng::new(SEED, domain).normals(view, shape, &device);
    let camera = |view: u64| {
        std::array::from_fn(|i| Rng::new(SEED, "golden/camera").normal(0, 16 * view + i as u64))
    };
    let view = |(view, [h, w]): (u64, [usize; 2])| ViewLatents {
        name: format!("view_{view:03}"),
        latent: compute::elementwise::scale(&normals("golden/latent", view, &[16, h, w]), 0.6),
        low: compute::elementwise::scale(&normals("golden/low", view, &[3, h, w]), 0.5),
        mask: None,
        camera: camera(view),
    };
    [(0, [14, 12]), (1, [12, 16])].map(view).to_vec()
}

/// The state with another LoRA: random in all its matrices, so that every one matters from the
/// first step on.
fn with_random_lora(mut state: State) -> State {
    if let Some(lora) = &mut state.lora {
        let random = |(i, (name, values)): (u64, (&String, &compute::Array))| {
            let deviation = if name.contains("lora_A") { 0.25 } else { 0.05 };
            let normals = Rng::new(SEED, "golden/lora").normals(i, values.shape(), values.device());
            (
                name.clone(),
                compute::elementwise::scale(&normals, deviation),
            )
        };
        *lora = LoraState::new((0..).zip(&lora.parameters).map(random).collect());
    }
    state
}

fn run(guidance: Guidance) -> Vec<StepLog> {
    let prior = Prior::load(&ModelSource::Embedded, &Device::cpu()).unwrap();
    let options = Options {
        guidance,
        steps: 10,
        crop: 10,
        guidance_scale: 2.0,
        ..Options::default()
    };
    let denoiser = prior.denoiser(&options.prompt, &options.negative_prompt);
    let views = views();
    let fresh = || Optimization::new(&denoiser, &views, &options, SEED).unwrap();
    let mut optimization = fresh()
        .resume(with_random_lora(fresh().state().clone()))
        .unwrap();
    std::iter::from_fn(|| (!optimization.is_done()).then(|| optimization.step().unwrap())).collect()
}

/// Compares every figure of every step.
#[track_caller]
fn assert_follows(mode: &str, log: &[StepLog], tolerance: f64) {
    let golden: BTreeMap<String, Vec<BTreeMap<String, f64>>> =
        serde_json::from_str(include_str!("../golden/guidance.json")).unwrap();
    assert_eq!(log.len(), golden[mode].len());
    for (step, (line, expected)) in log.iter().zip(&golden[mode]).enumerate() {
        let line = serde_json::to_value(line).unwrap();
        for (figure, &expected) in expected {
            let place = if figure == "lora_loss" {
                &line["lora_loss"]
            } else {
                &line["guidance"][figure]
            };
            let actual = place.as_f64().unwrap();
            let off = (actual / expected - 1.0).abs();
            assert!(
                off < tolerance,
                "{mode} step {step}: {figure} is {actual}, not {expected} ({off:.1e} off)"
            );
        }
    }
}

#[test]
fn rsd_follows_pytorch() {
    assert_follows(
        "rsd",
        &run(Guidance::Rsd(Rsd {
            rate: 0.02,
            ..Rsd::default()
        })),
        1e-4,
    );
}

#[test]
fn sds_follows_pytorch() {
    assert_follows(
        "sds",
        &run(Guidance::Sds(Sds {
            rate: 0.02,
            ..Sds::default()
        })),
        1e-4,
    );
}

#[test]
fn vsd_follows_pytorch() {
    let vsd = Vsd {
        rate: 0.01,
        lora_every: 1,
        warm_up: 2,
        lora_rate: 1e-3,
        lora_rank: 4,
        camera_drop: 0.5,
        anchor: 0.1,
        ..Vsd::default()
    };
    assert_follows("vsd", &run(Guidance::Vsd(vsd)), 1e-4);
}
