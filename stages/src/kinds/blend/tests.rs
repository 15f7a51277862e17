//! Details that add up, contradictions of the photo that are taken back, a gain that is refused.

use super::*;

fn image(device: &Device, side: usize, value: impl Fn(usize) -> f32) -> Array {
    device.array(&[1, 1, side, side], (0..side * side).map(value).collect())
}

#[test]
fn detail_that_either_has_is_added_up_on_the_photo() {
    let device = Device::cpu();
    let low = Low {
        values: image(&device, 2, |_| 0.5),
        counts: None,
    };
    let checks = |height: f32| {
        move |i: usize| {
            0.5 + if (i / 8 + i).is_multiple_of(2) {
                height
            } else {
                -height
            }
        }
    };
    let blend = Blend {
        back_projection: 1,
        ..Blend::default()
    };
    let detail = blend.detail(
        image(&device, 8, checks(0.1)),
        image(&device, 8, checks(0.2)),
        &low,
    );
    let sum = blend
        .sum(
            &detail,
            Shares {
                images: 0.5,
                own: 1.0,
            },
            &low,
        )
        .to_vec();
    let wanted = checks(0.5 * 0.1 + 0.2);
    assert!(
        sum.iter()
            .enumerate()
            .all(|(i, x)| (x - wanted(i)).abs() < 0.02),
        "{sum:?}"
    );
}

#[test]
fn what_contradicts_the_photo_is_taken_back() {
    let device = Device::cpu();
    let low = Low {
        values: image(&device, 4, |_| 0.5),
        counts: None,
    };
    let blend = Blend {
        back_projection: 5,
        ..Blend::default()
    };
    let detail = blend.detail(
        image(&device, 16, |_| 0.7),
        image(&device, 16, |_| 0.2),
        &low,
    );
    let sum = blend
        .sum(
            &detail,
            Shares {
                images: 1.0,
                own: 1.0,
            },
            &low,
        )
        .to_vec();
    assert!(sum.iter().all(|x| (x - 0.5).abs() < 1e-3), "{sum:?}");
}

#[test]
fn a_gain_below_nothing_is_refused() {
    let blend = Blend {
        own_gain: -0.1,
        ..Blend::default()
    };
    assert_eq!(
        blend.check().unwrap_err().to_string(),
        "`own_gain` is -0.1; it must be 0 to 10"
    );
}
