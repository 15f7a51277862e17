//! Group and layer normalisation, forward and backward to the input.

use super::groups::{Activation, Groups};
use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::chunks::{CHUNK, fill};
use crate::runtime::cpu::lanes;
use crate::runtime::cpu::math::{silu, silu_slope};
use crate::runtime::cpu::simd::vectorize;

/// Rows of `width` elements per task of layer normalisation.
fn rows_per_task(width: usize) -> usize {
    (CHUNK / width.max(1)).max(1)
}

/// What a group is normalised by. The mean comes in two parts, the second what the first lost by
/// rounding: in a group whose numbers hardly differ, that is much of what they differ by.
#[derive(Clone, Copy)]
struct Moments {
    mean: f32,
    rest: f32,
    /// The reciprocal of the standard deviation.
    rstd: f32,
}

impl Moments {
    /// From the sums over `count` elements of their distance from `mean`, and of its square.
    #[inline(always)]
    fn new(mean: f32, [sum, squares]: [f32; 2], count: f32, eps: f32) -> Moments {
        let rest = sum / count;
        Moments {
            mean,
            rest,
            // The variance about the mean itself: `squares` is about its rounded value.
            rstd: 1.0 / (squares / count - rest * rest + eps).sqrt(),
        }
    }

    #[inline(always)]
    fn of(x: &[f32], eps: f32) -> Moments {
        let count = x.len() as f32;
        let mean = lanes::sum(x, |x| x) / count;
        let sums = [
            // A second pass: squares less the mean's square would cancel where a group hardly
            // varies.
            lanes::sum(x, |x| x - mean),
            lanes::sum(x, |x| (x - mean) * (x - mean)),
        ];
        Moments::new(mean, sums, count, eps)
    }

    #[inline(always)]
    fn centre(self, x: f32) -> f32 {
        (x - self.mean) - self.rest
    }
}

/// Group `i` of all images: its range of elements begins here, and its channels begin there.
fn group_at(i: usize, g: Groups) -> (usize, usize) {
    let channels = g.channels / g.groups;
    (i * channels * g.plane, i % g.groups * channels)
}

/// `x` normalised group by group, scaled, shifted and activated.
pub fn group(
    x: &[f32],
    gamma: &[f32],
    beta: &[f32],
    g: Groups,
    activation: Activation,
) -> HostBuffer {
    let mut out = HostBuffer::uninitialised(x.len());
    fill(
        &mut out,
        // A group is one task: its sums have one order.
        (g.channels / g.groups * g.plane).max(1),
        |i, out| {
            let (start, channel) = group_at(i, g);
            let x = &x[start..start + out.len()];
            vectorize(
                #[inline(always)]
                || {
                    let moments = Moments::of(x, g.eps);
                    for (c, (out, x)) in out.chunks_mut(g.plane).zip(x.chunks(g.plane)).enumerate()
                    {
                        let scale = gamma[channel + c] * moments.rstd;
                        let shift = beta[channel + c];
                        match activation {
                            Activation::None => {
                                for (out, x) in out.iter_mut().zip(x) {
                                    *out = moments.centre(*x) * scale + shift;
                                }
                            }
                            Activation::Silu => {
                                for (out, x) in out.iter_mut().zip(x) {
                                    *out = silu(moments.centre(*x) * scale + shift);
                                }
                            }
                        }
                    }
                },
            );
        },
    );
    out
}

/// The gradient of [`group`] to `x`.
pub fn group_backward(
    x: &[f32],
    gamma: &[f32],
    beta: &[f32],
    g: Groups,
    activation: Activation,
    dy: &[f32],
) -> HostBuffer {
    let mut dx = HostBuffer::uninitialised(x.len());
    fill(
        &mut dx,
        (g.channels / g.groups * g.plane).max(1),
        |i, dx| {
            let (start, channel) = group_at(i, g);
            let x = &x[start..start + dx.len()];
            let dy = &dy[start..start + dx.len()];
            vectorize(
                #[inline(always)]
                || {
                    let moments = Moments::of(x, g.eps);
                    for (c, dx) in dx.chunks_mut(g.plane).enumerate() {
                        let x = &x[c * g.plane..];
                        let dy = &dy[c * g.plane..];
                        let gamma = gamma[channel + c];
                        let scale = gamma * moments.rstd;
                        let shift = beta[channel + c];
                        match activation {
                            Activation::None => {
                                for (dx, dy) in dx.iter_mut().zip(dy) {
                                    *dx = dy * gamma;
                                }
                            }
                            Activation::Silu => {
                                for ((dx, x), dy) in dx.iter_mut().zip(x).zip(dy) {
                                    *dx =
                                        dy * silu_slope(moments.centre(*x) * scale + shift) * gamma;
                                }
                            }
                        }
                    }
                    project(x, dx, moments);
                },
            );
        },
    );
    dx
}

/// Takes `dx` from the gradient to the normalised values to the gradient to `x`: what the mean and
/// the variance fix cannot change.
#[inline(always)]
fn project(x: &[f32], dx: &mut [f32], moments: Moments) {
    let count = x.len() as f32;
    // rstd (g - mean(g) - xhat mean(g xhat)), with g the gradient to the normalised xhat.
    let along_mean = lanes::sum(dx, |dx| dx) / count;
    let along_value =
        lanes::sum_pairs(dx, x, |dx, x| dx * moments.centre(x)) / count * moments.rstd;
    for (dx, x) in dx.iter_mut().zip(x) {
        *dx = moments.rstd * (*dx - along_mean - moments.centre(*x) * moments.rstd * along_value);
    }
}

/// Each row of `gamma.len()` elements normalised, scaled and shifted.
pub fn layer(x: &[f32], gamma: &[f32], beta: &[f32], eps: f32) -> HostBuffer {
    let width = gamma.len();
    let rows = rows_per_task(gamma.len());
    let mut out = HostBuffer::uninitialised(x.len());
    fill(&mut out, rows * width, |i, out| {
        let pairs = out
            .chunks_exact_mut(width)
            .zip(x[i * rows * width..].chunks_exact(width));
        vectorize(
            #[inline(always)]
            || {
                for (out, x) in pairs {
                    let mean = lanes::sums(x, x, x, |x, _, _| [x])[0] / width as f32;
                    let sums = lanes::sums(x, x, x, |x, _, _| [x - mean, (x - mean) * (x - mean)]);
                    let moments = Moments::new(mean, sums, width as f32, eps);
                    for (((out, x), gamma), beta) in out.iter_mut().zip(x).zip(gamma).zip(beta) {
                        *out = moments.centre(*x) * moments.rstd * gamma + beta;
                    }
                }
            },
        );
    });
    out
}

/// The gradient of [`layer`] to `x`.
pub fn layer_backward(x: &[f32], gamma: &[f32], eps: f32, dy: &[f32]) -> HostBuffer {
    let width = gamma.len();
    let rows = rows_per_task(gamma.len());
    let mut dx = HostBuffer::uninitialised(x.len());
    fill(&mut dx, rows * width, |i, dx| {
        let inputs = x[i * rows * width..]
            .chunks_exact(width)
            .zip(dy[i * rows * width..].chunks_exact(width));
        let triples = dx.chunks_exact_mut(width).zip(inputs);
        vectorize(
            #[inline(always)]
            || {
                for (dx, (x, dy)) in triples {
                    layer_row_backward(x, gamma, eps, dy, dx);
                }
            },
        );
    });
    dx
}

/// One row, whose sums are taken all at once.
#[inline(always)]
fn layer_row_backward(x: &[f32], gamma: &[f32], eps: f32, dy: &[f32], dx: &mut [f32]) {
    let count = x.len() as f32;
    let mean = lanes::sums(x, x, x, |x, _, _| [x])[0] / count;
    let [sum, squares, slopes, along] = lanes::sums(x, dy, gamma, |x, dy, gamma| {
        let x = x - mean;
        let slope = dy * gamma;
        [x, x * x, slope, slope * x]
    });
    let moments = Moments::new(mean, [sum, squares], count, eps);
    let along_mean = slopes / count;
    // `along` is about the rounded mean; what its rest adds is taken off.
    let along_value = (along - moments.rest * slopes) / count * moments.rstd;
    for (((dx, x), dy), gamma) in dx.iter_mut().zip(x).zip(dy).zip(gamma) {
        *dx = moments.rstd
            * (dy * gamma - along_mean - moments.centre(*x) * moments.rstd * along_value);
    }
}
