//! Resampling images by separable filters, with gradients. It knows pixel centres at half-integers
//! and the conventions of PyTorch and Pillow; it knows no colour space, so give it linear light
//! where that matters.

mod cpu;
mod filter;
mod gpu;
#[cfg(test)]
mod tests;

use crate::runtime::array::{Array, nchw};
use crate::runtime::device::Backend;

pub use filter::Filter;

/// Resamples `x [N, C, H, W]` to `height` by `width`. `antialias` widens the filter's support where
/// the image shrinks.
pub fn resize(x: &Array, height: usize, width: usize, filter: Filter, antialias: bool) -> Array {
    let [n, c, h, w] = nchw("resize", x);
    assert!(
        h * w * height * width > 0,
        "resize: {:?} to {height}x{width}",
        x.shape()
    );
    let [vertical, horizontal] =
        [(h, height), (w, width)].map(|(from, to)| filter.taps(from, to, antialias));
    match x.device().backend() {
        Backend::Cpu => {
            let values = cpu::separable(x.host(), [h, w], &vertical, &horizontal);
            Array::on_cpu(&[n, c, height, width], values)
        }
        Backend::Gpu(gpu) => {
            let values = gpu::separable(
                gpu,
                x.device_buffer(),
                [h, w],
                x.len(),
                &vertical,
                &horizontal,
            );
            Array::on_gpu(gpu, &[n, c, height, width], values)
        }
    }
}

/// The gradient of [`resize`] from images of `h_in` by `w_in`, given the gradient `dy` to its
/// output.
pub fn resize_backward(
    dy: &Array,
    h_in: usize,
    w_in: usize,
    filter: Filter,
    antialias: bool,
) -> Array {
    let [n, c, h, w] = nchw("resize_backward", dy);
    assert!(
        h * w * h_in * w_in > 0,
        "resize_backward: {:?} from {h_in}x{w_in}",
        dy.shape()
    );
    // Resampling is linear in the pixels, so its gradient is the transpose.
    let [vertical, horizontal] =
        [(h_in, h), (w_in, w)].map(|(from, to)| filter.taps(from, to, antialias).transposed(from));
    match dy.device().backend() {
        Backend::Cpu => {
            let values = cpu::separable(dy.host(), [h, w], &vertical, &horizontal);
            Array::on_cpu(&[n, c, h_in, w_in], values)
        }
        Backend::Gpu(gpu) => {
            let values = gpu::separable(
                gpu,
                dy.device_buffer(),
                [h, w],
                dy.len(),
                &vertical,
                &horizontal,
            );
            Array::on_gpu(gpu, &[n, c, h_in, w_in], values)
        }
    }
}
