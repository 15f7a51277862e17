//! Resampling against PyTorch, Pillow and its own adjoint, and on a GPU.

use proptest::prelude::*;

use super::*;
use crate::Device;
use crate::check::{
    agree, assert_adjoint, assert_close, assert_same_bits, check_resized, dot, pattern,
};

const FILTERS: [Filter; 6] = [
    Filter::Nearest,
    Filter::Bilinear,
    Filter::BicubicTorch,
    Filter::BicubicPil,
    Filter::Lanczos3,
    Filter::Area,
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 4))]

    #[test]
    fn resize_has_an_adjoint(
        (h, w, height, width) in (1usize..40, 1usize..40, 1usize..40, 1usize..40),
        antialias: bool,
        filter in prop::sample::select(FILTERS.to_vec()),
    ) {
        let x = pattern(1, &[2, 1, h, w]);
        let dy = pattern(2, &[2, 1, height, width]);
        let y = resize(&x, height, width, filter, antialias);
        assert_adjoint("resize", &y, &dy, dot(&x, &resize_backward(&dy, h, w, filter, antialias)));
    }

    #[test]
    fn resize_keeps_a_constant(
        (h, w, height, width) in (1usize..40, 1usize..40, 1usize..40, 1usize..40),
        antialias: bool,
        filter in prop::sample::select(FILTERS.to_vec()),
    ) {
        let ones = Device::cpu().full(&[1, 1, h, w], 1.0);
        let expected = Device::cpu().full(&[1, 1, height, width], 1.0);
        assert_close("resize", &resize(&ones, height, width, filter, antialias), &expected, 1e-6);
    }
}

#[test]
fn resizing_is_torchs() {
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
        check_resized(name, &y);
    }
}

#[test]
fn resizing_is_pillows() {
    let cases = [
        ("bicubic_pil_down", [47, 63], [12, 16], Filter::BicubicPil),
        ("bicubic_pil_up", [9, 13], [36, 52], Filter::BicubicPil),
        ("lanczos_down", [47, 63], [12, 16], Filter::Lanczos3),
        ("lanczos_up", [9, 13], [36, 52], Filter::Lanczos3),
        ("bilinear_pil_down", [47, 63], [12, 16], Filter::Bilinear),
    ];
    for (name, [h, w], [height, width], filter) in cases {
        check_resized(
            name,
            &resize(&pattern(15, &[1, 1, h, w]), height, width, filter, true),
        );
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let x = pattern(1, &[2, 3, 130, 129]);
    assert_same_bits("resize", || {
        vec![resize(&x, 47, 200, Filter::Lanczos3, true)]
    });
}

/// What a GPU gives beside the CPU. Skipped where there is no adapter.
mod on_a_gpu {
    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 21))]

        #[test]
        fn resizes(
            (h, w, height, width) in (1usize..40, 1usize..40, 1usize..40, 1usize..40),
            antialias: bool,
            filter in prop::sample::select(FILTERS.to_vec()),
        ) {
            let inputs = [pattern(1, &[2, 3, h, w]), pattern(2, &[2, 3, height, width])];
            agree("resize", &inputs, |x| vec![
                resize(&x[0], height, width, filter, antialias),
                resize_backward(&x[1], h, w, filter, antialias),
            ]);
        }
    }
}
