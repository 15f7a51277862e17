//! On a GPU beside the CPU, on whatever adapter comes first: one of software does. Where there is
//! none the tests pass with a message, unless `SRNERF_REQUIRE_GPU` is set, as `make test` does.

use compute::testing::{gpu, weak_gpu};
use compute::{Counts, Device};
use formats::Pixels;
use nerf::{
    Field, FieldConfig, RenderOptions, Renderer, Tensors, TrainOptions, TrainView, Training,
};

use crate::common::{BOUNDS, camera, config, from_one_side, in_perspective, options, psnr, views};

/// Less than elsewhere in these tests: a GPU of software is slow.
fn little() -> (FieldConfig, Vec<TrainView>, TrainOptions) {
    let views = views()
        .into_iter()
        .map(|view| TrainView {
            supersample: 1,
            ..view
        })
        .collect();
    (
        FieldConfig {
            levels: 5,
            march_steps: 40,
            ..config()
        },
        views,
        TrainOptions {
            samples: 256,
            ..options(50)
        },
    )
}

fn training(device: &Device) -> Training {
    let (config, views, options) = little();
    Training::new(device, Field::new(&config, BOUNDS, 1), views, &options, 1)
}

/// Fails if steps give the device more to do, by any measure, than they did.
#[track_caller]
fn assert_costs(costs: &[Counts]) {
    assert!(
        costs
            .iter()
            .all(|cost| (cost.submissions, cost.read_backs) == (2, 1)),
        "{costs:?}"
    );
    let expected = Counts {
        dispatches: 10,
        submissions: 2,
        read_backs: 1,
        operations: 51_824_640,
        bytes: 21_968_480,
        uploaded: 1536,
        pipelines: 0,
    };
    assert_eq!(costs[14], expected);
    assert_eq!(
        (costs[15].dispatches, costs[31].dispatches),
        (13, 13),
        "with an update of the occupancy grid"
    );
}

#[test]
fn fifty_steps_follow_the_cpu_and_an_image_is_the_same() {
    let Some(gpu) = gpu() else { return };
    let [mut here, mut there] = [&Device::cpu(), &gpu].map(training);
    let mut costs: Vec<Counts> = Vec::new();
    for step in 0..50 {
        let before = gpu.counts().unwrap();
        let expected = here.step();
        let got = there.step();
        costs.push(gpu.counts().unwrap() - before);
        assert!(
            (expected.loss / got.loss - 1.0).abs() < 1e-3,
            "step {step}: {} beside {}",
            got.loss,
            expected.loss
        );
        assert_eq!(
            (expected.rays, expected.samples),
            (got.rays, got.samples),
            "step {step}"
        );
    }
    assert_costs(&costs);
    let field = there.into_field();
    let options = RenderOptions {
        supersample: 2,
        ..Default::default()
    };
    let [expected, got] = [&Device::cpu(), &gpu]
        .map(|device| Renderer::new(device, &field).render(&camera(0.39, 16), &options));
    for (expected, got) in [
        (&expected.rgb, &got.rgb),
        (&expected.opacity, &got.opacity),
        (&expected.depth, &got.depth),
    ] {
        assert!(psnr(got, expected) > 50.0, "{} dB", psnr(got, expected));
    }
    // A GPU shades the faint samples of a ray as well.
    assert!(expected.samples <= got.samples);
}

#[test]
fn a_scene_seen_from_one_side_is_the_same_in_perspective() {
    let Some(gpu) = gpu() else { return };
    let (config, _, options) = little();
    let views: Vec<_> = from_one_side()
        .into_iter()
        .map(|view| TrainView {
            supersample: 1,
            ..view
        })
        .collect();
    let [mut here, mut there] = [&Device::cpu(), &gpu].map(|device| {
        Training::new(
            device,
            in_perspective(&config, &views),
            views.clone(),
            &options,
            1,
        )
    });
    for step in 0..20 {
        let expected = here.step();
        let got = there.step();
        assert!(
            (expected.loss / got.loss - 1.0).abs() < 1e-3,
            "step {step}: {} beside {}",
            got.loss,
            expected.loss
        );
        assert_eq!(
            (expected.rays, expected.samples),
            (got.rays, got.samples),
            "step {step}"
        );
    }
    let field = there.into_field();
    let images = [&Device::cpu(), &gpu].map(|device| {
        Renderer::new(device, &field).render(&camera(0.1, 16), &RenderOptions::default())
    });
    assert!(
        psnr(&images[0].rgb, &images[1].rgb) > 50.0
            && psnr(&images[0].depth, &images[1].depth) > 50.0
    );
}

/// The states after eight steps and after eighteen, past an update of the occupancy grid.
fn run(device: &Device) -> [Tensors; 2] {
    let mut training = training(device);
    [8, 18].map(|end| {
        while training.steps_taken() < end {
            training.step();
        }
        training.state()
    })
}

#[test]
fn two_runs_and_one_that_goes_on_from_a_state_give_the_same_bits() {
    let Some(gpu) = gpu() else { return };
    let [half, whole] = run(&gpu);
    assert!([half.clone(), whole.clone()] == run(&gpu));
    let (config, views, options) = little();
    let mut resumed =
        Training::from_state(&gpu, &config, BOUNDS, views, &options, 1, &half).unwrap();
    assert!(
        resumed.state() == half,
        "a state goes through a trainer unchanged"
    );
    while resumed.steps_taken() < 18 {
        resumed.step();
    }
    assert!(resumed.state() == whole);
}

#[test]
fn a_gpu_that_sees_little_of_an_array_at_once_learns_the_same_bits() {
    let Some(wide) = gpu() else { return };
    // Its gradient takes 4 MiB, and the parts of that to the weights more than twice as much.
    let Some(narrow) = weak_gpu(1 << 20) else {
        return;
    };
    let learnt = [wide, narrow].map(|device| {
        let (config, views, options) = little();
        let config = FieldConfig {
            log2_table: 16,
            base_resolution: 40,
            ..config
        };
        let mut training =
            Training::new(&device, Field::new(&config, BOUNDS, 1), views, &options, 1);
        (0..3).for_each(|_| _ = training.step());
        training.state()
    });
    assert!(learnt[0] == learnt[1]);
}

#[test]
fn a_loss_that_is_not_a_number_leaves_the_field_as_it_was() {
    let Some(gpu) = gpu() else { return };
    let mut training = training(&gpu);
    (0..3).for_each(|_| _ = training.step());
    let (config, mut views, options) = little();
    views
        .iter_mut()
        .for_each(|view| view.pixels = Pixels::opaque(vec![f32::NAN; 3 * 32 * 32]).into());
    let before = training.state();
    let mut blind =
        Training::from_state(&gpu, &config, BOUNDS, views, &options, 1, &before).unwrap();
    assert!(blind.step().loss.is_nan());
    let after = blind.state();
    assert!(
        before
            .iter()
            .all(|(name, tensor)| name.starts_with("trainer.") || after[name] == *tensor)
    );
}
