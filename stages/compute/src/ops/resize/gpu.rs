//! Resampling by windows of weights, one axis after the other.

use super::filter::Taps;
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::each::Each;
use crate::runtime::gpu::params::params;
use crate::runtime::gpu::pool::Buffer;

params! {
    /// The middle axis of `[outer, from_len, inner]`, resampled to `to`.
    struct Axis {
        from_len: u32,
        to: u32,
        inner: u32,
    }
}

/// Planes of `[h, w]` resampled both ways; `len` elements in all.
pub fn separable(
    gpu: &Gpu,
    x: &Buffer,
    [h, w]: [usize; 2],
    len: usize,
    vertical: &Taps,
    horizontal: &Taps,
) -> Buffer {
    let tall = along(gpu, x, [len / (h * w), h, w], vertical);
    along(
        gpu,
        &tall,
        [len / (h * w) * vertical.windows.len(), w, 1],
        horizontal,
    )
}

/// Resamples the middle axis of `[outer, from, inner]`.
fn along(gpu: &Gpu, x: &Buffer, [outer, from, inner]: [usize; 3], taps: &Taps) -> Buffer {
    let mut weights = Vec::new();
    let mut windows = Vec::new();
    for window in &taps.windows {
        // First pixel, first weight, how many: three words a window.
        windows.extend([
            window.first as u32,
            weights.len() as u32,
            window.weights.len() as u32,
        ]);
        weights.extend_from_slice(&window.weights);
    }
    let [weights, windows] = [
        gpu.upload(bytemuck::cast_slice(&weights)),
        gpu.upload(bytemuck::cast_slice(&windows)),
    ];
    let to = taps.windows.len();
    let params = Axis {
        from_len: from as u32,
        to: to as u32,
        inner: inner as u32,
    };
    let value = "let o = i / p.inner % p.to; var sum = 0.0;
    let start = (i / (p.inner * p.to) * p.from_len + windows[3u * o]) * p.inner + i % p.inner;
    for (var k = 0u; k < windows[3u * o + 2u]; k++) {
        sum += weights[windows[3u * o + 1u] + k] * x[start + k * p.inner];
    }
    return sum;";
    let reads = [
        ("x: f32", x),
        ("weights: f32", &weights),
        ("windows: u32", &windows),
    ];
    Each {
        name: "resize",
        reads: &reads,
        params,
        value,
        functions: "",
    }
    .run(gpu, outer * to * inner)
}
