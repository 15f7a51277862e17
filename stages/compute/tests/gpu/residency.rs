//! What must not happen on a GPU: values that come back within a pass, memory that grows from step
//! to step, other bits in another run.

use compute::conv::{Conv, conv2d};
use compute::device::attempt;
use compute::norm::{Activation, group_norm};
use compute::{Array, Device, GpuError, testing};

use crate::common::{gpu, pattern, to};

/// A few layers, as a network has them.
fn pass(x: &Array, weight: &Array, gamma: &Array, beta: &Array) -> Array {
    let layer = |x: &Array| {
        conv2d(
            &group_norm(x, gamma, beta, 4, 1e-5, Activation::Silu),
            weight,
            None,
            Conv::padded(1),
        )
    };
    layer(&layer(&layer(x)))
}

#[test]
fn a_pass_is_one_submission_without_a_read_back_and_always_gives_the_same_bits() {
    // A device of its own: the other tests count too.
    let Some(device) = testing::gpu() else { return };
    let shapes: [&[usize]; 4] = [&[2, 8, 20, 12], &[8, 8, 3, 3], &[8], &[8]];
    let inputs: Vec<Array> = (0..4)
        .map(|i| to(&device, &pattern(i, shapes[i as usize])))
        .collect();
    let run = || pass(&inputs[0], &inputs[1], &inputs[2], &inputs[3]);
    let first = run().to_vec();
    let before = device.counts().unwrap();
    let second = run();
    let recorded = device.counts().unwrap() - before;
    assert_eq!(
        (
            recorded.dispatches,
            recorded.submissions,
            recorded.read_backs
        ),
        (9, 0, 0)
    );
    assert_eq!(
        (recorded.uploaded, recorded.pipelines),
        (0, 0),
        "nothing moves, and nothing is compiled again"
    );
    assert_eq!(second.to_vec(), first);
    let read = device.counts().unwrap() - before;
    assert_eq!((read.submissions, read.read_backs), (1, 1));
}

#[test]
fn an_upload_waits_for_no_command_and_disturbs_none() {
    let Some(gpu) = gpu() else { return };
    let x = gpu.array(&[1000], vec![1.0; 1000]);
    let y = compute::elementwise::scale(&x, 2.0);
    drop(x);
    // Of the size of `x`, whose memory the command above has not read yet.
    let z = gpu.array(&[1000], vec![5.0; 1000]);
    assert_eq!((y.to_vec(), z.to_vec()), (vec![2.0; 1000], vec![5.0; 1000]));
}

#[test]
fn an_array_beyond_the_adapters_limits_is_an_error_that_says_what_to_lower() {
    let Some(gpu) = gpu() else { return };
    let fault = attempt(|| gpu.zeros(&[1 << 40])).unwrap_err();
    assert!(matches!(fault, GpuError::TooLarge { .. }), "{fault}");
    assert!(fault.to_string().contains("lower the crop"), "{fault}");
    assert_eq!(
        attempt(|| gpu.full(&[3], 2.0).to_vec()),
        Ok(vec![2.0; 3]),
        "the device goes on"
    );
}

#[test]
fn full_memory_is_an_error_that_says_what_to_lower_and_the_device_goes_on() {
    let Some(device) = testing::gpu() else { return };
    let kept = device.full(&[1000], 2.0);
    testing::limit_memory(&device, 1 << 20);
    let fault = attempt(|| device.full(&[1 << 19], 1.0)).unwrap_err();
    assert!(
        matches!(fault, GpuError::OutOfMemory { held: 1 }),
        "{fault}"
    );
    assert!(fault.to_string().contains("lower the crop"), "{fault}");
    assert_eq!(attempt(|| kept.to_vec()), Ok(vec![2.0; 1000]));
    testing::limit_memory(&device, u64::MAX);
    assert!(attempt(|| device.full(&[1 << 19], 1.0).to_vec()).is_ok());
}

#[test]
fn a_lost_device_is_an_error_whatever_is_asked_of_it() {
    let Some(device) = testing::gpu() else { return };
    let x = device.full(&[1000], 2.0);
    device.finish();
    testing::lose(&device);
    let asked: [&dyn Fn(); 3] = [&|| drop(x.to_vec()), &|| device.finish(), &|| {
        drop(device.zeros(&[5]))
    }];
    for ask in asked {
        let fault = attempt(ask).unwrap_err();
        assert!(matches!(fault, GpuError::Lost(_)), "{fault}");
        assert!(
            fault
                .to_string()
                .contains("goes on from the last checkpoint"),
            "{fault}"
        );
    }
}

#[test]
fn an_adapter_that_is_not_there_is_an_error() {
    let Some(_) = gpu() else { return };
    let error = Device::gpu(Some(999)).unwrap_err();
    assert!(
        matches!(error, GpuError::NoSuchAdapter { asked: 999, .. }),
        "{error}"
    );
}
