//! Moving values around without changing them, with the gradients that are not moves themselves.

mod cpu;
mod gpu;
#[cfg(test)]
mod tests;

use crate::runtime::array::{Array, nchw};
use crate::runtime::device::Backend;
use crate::runtime::weight::{Weight, matrix};

/// The extents before, at and after an axis.
fn around(op: &str, x: &Array, axis: usize) -> [usize; 3] {
    assert!(
        axis < x.shape().len(),
        "{op}: {:?} has no axis {axis}",
        x.shape()
    );
    let product = |shape: &[usize]| shape.iter().product();
    [
        product(&x.shape()[..axis]),
        x.shape()[axis],
        product(&x.shape()[axis + 1..]),
    ]
}

/// Joins arrays along `axis`; all other extents must agree.
pub fn concat(parts: &[&Array], axis: usize) -> Array {
    let [first, ..] = parts else {
        panic!("concat: no arrays")
    };
    let mut shape = first.shape().to_vec();
    let [outer, _, inner] = around("concat", first, axis);
    shape[axis] = parts
        .iter()
        .map(|part| around("concat", part, axis)[1])
        .sum();
    for part in parts {
        let agrees = part
            .shape()
            .iter()
            .enumerate()
            .all(|(i, &extent)| i == axis || shape.get(i) == Some(&extent));
        assert!(
            agrees && part.shape().len() == shape.len(),
            "concat: {:?} and {:?}",
            first.shape(),
            part.shape()
        );
    }
    match first.device().backend() {
        Backend::Cpu => {
            let rows: Vec<_> = parts
                .iter()
                .map(|part| (part.host(), part.shape()[axis] * inner))
                .collect();
            Array::on_cpu(&shape, cpu::concat(&rows, outer))
        }
        Backend::Gpu(gpu) => {
            let rows: Vec<_> = parts
                .iter()
                .map(|part| (part.device_buffer(), part.shape()[axis] * inner))
                .collect();
            Array::on_gpu(gpu, &shape, gpu::concat(gpu, &rows, outer))
        }
    }
}

/// The part `start..start + len` of `axis`.
pub fn slice(x: &Array, axis: usize, start: usize, len: usize) -> Array {
    let [outer, extent, inner] = around("slice", x, axis);
    assert!(
        start + len <= extent,
        "slice: {start}..{} of axis {axis} of {:?}",
        start + len,
        x.shape()
    );
    let mut shape = x.shape().to_vec();
    shape[axis] = len;
    match x.device().backend() {
        Backend::Cpu => {
            let rows = (start * inner)..((start + len) * inner);
            Array::on_cpu(&shape, cpu::slice(x.host(), outer, extent * inner, rows))
        }
        Backend::Gpu(gpu) => {
            let rows = (start * inner)..((start + len) * inner);
            Array::on_gpu(
                gpu,
                &shape,
                gpu::slice(gpu, x.device_buffer(), outer, extent * inner, rows),
            )
        }
    }
}

/// An image `[N, C, H, W]` as tokens `[N, H * W, C]`.
pub fn nchw_to_tokens(x: &Array) -> Array {
    let [n, c, h, w] = nchw("nchw_to_tokens", x);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(&[n, h * w, c], cpu::transpose(x.host(), n, c, h * w)),
        Backend::Gpu(gpu) => Array::on_gpu(
            gpu,
            &[n, h * w, c],
            gpu::transpose(gpu, x.device_buffer(), n, c, h * w),
        ),
    }
}

/// Tokens `[N, H * W, C]` as an image `[N, C, H, W]`.
pub fn tokens_to_nchw(x: &Array, h: usize, w: usize) -> Array {
    let &[n, tokens, c] = x.shape() else {
        panic!("tokens_to_nchw: expected [N, T, C], got {:?}", x.shape())
    };
    assert_eq!(
        tokens,
        h * w,
        "tokens_to_nchw: {:?} is no {h}x{w} image",
        x.shape()
    );
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(&[n, c, h, w], cpu::transpose(x.host(), n, tokens, c)),
        Backend::Gpu(gpu) => Array::on_gpu(
            gpu,
            &[n, c, h, w],
            gpu::transpose(gpu, x.device_buffer(), n, tokens, c),
        ),
    }
}

/// Every pixel of `x [N, C, H, W]` repeated `factor` times both ways.
pub fn upsample_nearest(x: &Array, factor: usize) -> Array {
    let [n, c, h, w] = nchw("upsample_nearest", x);
    assert!(factor > 0, "upsample_nearest: the factor must be positive");
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            &[n, c, h * factor, w * factor],
            cpu::upsample(x.host(), [n * c, h, w], factor),
        ),
        Backend::Gpu(gpu) => {
            let values = gpu::upsample(gpu, x.device_buffer(), [n * c, h, w], factor);
            Array::on_gpu(gpu, &[n, c, h * factor, w * factor], values)
        }
    }
}

/// The gradient of [`upsample_nearest`]: every block of `dy` summed.
pub fn upsample_nearest_backward(dy: &Array, factor: usize) -> Array {
    let [n, c, h, w] = nchw("upsample_nearest_backward", dy);
    let whole = factor > 0 && h % factor == 0 && w % factor == 0;
    assert!(
        whole,
        "upsample_nearest_backward: {:?} by {factor}",
        dy.shape()
    );
    let h = h / factor;
    let w = w / factor;
    match dy.device().backend() {
        Backend::Cpu => Array::on_cpu(
            &[n, c, h, w],
            cpu::upsample_backward(dy.host(), [n * c, h, w], factor),
        ),
        Backend::Gpu(gpu) => {
            let values = gpu::upsample_backward(gpu, dy.device_buffer(), [n * c, h, w], factor);
            Array::on_gpu(gpu, &[n, c, h, w], values)
        }
    }
}

/// Groups of `factor^2` neighbouring channels laid out as blocks of pixels, row by row: `[N, C
/// factor^2, H, W]` as `[N, C, H factor, W factor]` (Shi et al. 2016), PyTorch's `pixel_shuffle`.
pub fn pixel_shuffle(x: &Array, factor: usize) -> Array {
    let [n, c, h, w] = nchw("pixel_shuffle", x);
    let whole = factor > 0 && c % (factor * factor) == 0;
    assert!(whole, "pixel_shuffle: {:?} by {factor}", x.shape());
    let shape = [n, c / (factor * factor), h * factor, w * factor];
    let planes = n * c / (factor * factor);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(&shape, cpu::shuffle(x.host(), [planes, h, w], factor)),
        Backend::Gpu(gpu) => Array::on_gpu(
            gpu,
            &shape,
            gpu::shuffle(gpu, x.device_buffer(), [planes, h, w], factor),
        ),
    }
}

/// The inverse of [`pixel_shuffle`]: `[N, C, H factor, W factor]` as `[N, C factor^2, H, W]`.
pub fn pixel_unshuffle(x: &Array, factor: usize) -> Array {
    let [n, c, h, w] = nchw("pixel_unshuffle", x);
    let whole = factor > 0 && h % factor == 0 && w % factor == 0;
    assert!(whole, "pixel_unshuffle: {:?} by {factor}", x.shape());
    let h = h / factor;
    let w = w / factor;
    let shape = [n, c * factor * factor, h, w];
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(&shape, cpu::unshuffle(x.host(), [n * c, h, w], factor)),
        Backend::Gpu(gpu) => Array::on_gpu(
            gpu,
            &shape,
            gpu::unshuffle(gpu, x.device_buffer(), [n * c, h, w], factor),
        ),
    }
}

/// `x [N, C, H, W]` continued by mirroring at its edge pixels, `pad` = `[top, bottom, left, right]`
/// pixels wide. Each must be less than the image's extent that way.
pub fn pad_reflect(x: &Array, pad: [usize; 4]) -> Array {
    let [n, c, h, w] = nchw("pad_reflect", x);
    let [top, bottom, left, right] = pad;
    // Mirrored once only: beyond that an index would leave the image.
    let fits = top.max(bottom) < h && left.max(right) < w;
    assert!(fits, "pad_reflect: {pad:?} around {:?}", x.shape());
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            &[n, c, h + top + bottom, w + left + right],
            cpu::pad_reflect(x.host(), [n * c, h, w], pad),
        ),
        Backend::Gpu(gpu) => {
            let values = gpu::pad_reflect(gpu, x.device_buffer(), [n * c, h, w], pad);
            Array::on_gpu(gpu, &[n, c, h + top + bottom, w + left + right], values)
        }
    }
}

/// The window of `height` by `width` pixels of `x [N, C, H, W]` whose first pixel is (`top`,
/// `left`).
pub fn crop(x: &Array, top: usize, left: usize, height: usize, width: usize) -> Array {
    nchw("crop", x);
    slice(&slice(x, 2, top, height), 3, left, width)
}

/// Row `id` of `table [V, D]` for every id: `[ids, D]`.
pub fn gather_rows(table: impl Into<Weight>, ids: &[u32]) -> Array {
    let table = table.into();
    let [rows, depth] = matrix("gather_rows", &table);
    // Here, since a kernel on a GPU has no way to tell.
    assert!(
        ids.iter().all(|&id| (id as usize) < rows),
        "gather_rows: an id is beyond the {rows} rows"
    );
    match table.device().backend() {
        Backend::Cpu => Array::on_cpu(
            &[ids.len(), depth],
            cpu::gather_rows(table.host(), depth, ids),
        ),
        Backend::Gpu(gpu) => {
            let values = match table.array() {
                Some(array) => gpu::gather_rows(gpu, array.device_buffer(), depth, ids),
                // Of a table in a file, no other rows go to the device.
                None => {
                    let rows = cpu::gather_rows(table.host(), depth, ids);
                    gpu.upload(bytemuck::cast_slice(&rows))
                }
            };
            Array::on_gpu(gpu, &[ids.len(), depth], values)
        }
    }
}
