//! Milliseconds of the main operators on this machine, median and least; `ops.py` prints PyTorch's for the same shapes.
//! On a busy machine compare the least of runs that alternate, with one thread each.
//!
//! `cargo bench -p compute [-- part of a name]`, with `RAYON_NUM_THREADS` to set the threads.

use std::hint::black_box;
use std::time::Instant;

use compute::attention::{attention, attention_backward};
use compute::conv::{Conv, conv2d, conv2d_backward_input, conv2d_backward_weight};
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm, layer_norm_backward};
use compute::resize::{Filter, resize};
use compute::{Array, Device, activation, elementwise, linear, matmul, shape};

/// Numbers in [-2, 2) that look random.
fn noise(salt: u64, shape: &[usize]) -> Array {
    let len: usize = shape.iter().product();
    let value = |i: u64| ((i + salt * 7919).wrapping_mul(2_654_435_761) as u32) as f32 / (1u32 << 30) as f32 - 2.0;
    Device::cpu().array(shape, (0..len as u64).map(value).collect())
}

struct Bench {
    /// Only names that contain one of these run; all if there are none.
    wanted: Vec<String>,
}

impl Bench {
    /// Prints the median and the least time of `work`, over at least half a second and three runs.
    fn time<T>(&self, name: &str, mut work: impl FnMut() -> T) {
        if !self.wanted.is_empty() && !self.wanted.iter().any(|part| name.contains(part)) {
            return;
        }
        black_box(work());
        let (start, mut times) = (Instant::now(), Vec::new());
        while times.len() < 3 || (start.elapsed().as_secs_f64() < 0.5 && times.len() < 100) {
            let begin = Instant::now();
            black_box(work());
            times.push(begin.elapsed().as_secs_f64() * 1e3);
        }
        times.sort_by(f64::total_cmp);
        println!("{name} {:.3} {:.3}", times[times.len() / 2], times[0]);
    }

    fn products(&self) {
        for (m, k, n) in [(1024, 1024, 1024), (4096, 320, 1280), (3072, 96, 768), (3072, 128, 128)] {
            let (a, b, w) = (noise(1, &[m, k]), noise(2, &[k, n]), noise(3, &[n, k]));
            self.time(&format!("matmul_{m}x{k}x{n}"), || matmul::matmul(&a, &b));
            self.time(&format!("linear_{m}x{k}x{n}"), || linear::linear(&a, &w, None));
        }
    }

    fn convolution(&self, batch: usize, channels: [usize; 2], size: [usize; 2], kernel: usize, stride: usize) {
        let ([c, o], [h, w]) = (channels, size);
        let pad = if stride == 1 { [kernel / 2; 4] } else { [0, 1, 0, 1] };
        let conv = Conv { stride, pad };
        let (x, weight) = (noise(1, &[batch, c, h, w]), noise(2, &[o, c, kernel, kernel]));
        let dy = conv2d(&x, &weight, None, conv);
        let name = format!("conv{kernel}s{stride}_{batch}x{c}-{o}_{w}x{h}");
        self.time(&format!("{name}_forward"), || conv2d(&x, &weight, None, conv));
        self.time(&format!("{name}_input"), || conv2d_backward_input(&dy, &weight, conv, size));
        self.time(&format!("{name}_weight"), || conv2d_backward_weight(&x, &dy, conv, [kernel; 2]));
    }

    fn attentions(&self, batch: usize, tokens: usize, keys: usize, heads: usize, depth: usize) {
        let q = noise(1, &[batch, tokens, heads * depth]);
        let [k, v] = [2, 3].map(|salt| noise(salt, &[batch, keys, heads * depth]));
        let attended = attention(&q, &k, &v, heads, false);
        let name = format!("attention_{batch}x{tokens}-{keys}_{heads}x{depth}");
        self.time(&format!("{name}_forward"), || attention(&q, &k, &v, heads, false));
        self.time(&format!("{name}_backward"), || attention_backward(&q, &k, &v, &attended, heads, false, &q));
    }

    fn norms(&self, shape: [usize; 4]) {
        let [n, c, h, w] = shape;
        let (x, dy) = (noise(1, &shape), noise(2, &shape));
        let (gamma, beta) = (noise(3, &[c]), noise(4, &[c]));
        let act = Activation::Silu;
        let name = format!("{n}x{c}_{w}x{h}");
        self.time(&format!("group_norm_silu_{name}_forward"), || group_norm(&x, &gamma, &beta, 32, 1e-5, act));
        self.time(&format!("group_norm_silu_{name}_backward"), || {
            group_norm_backward(&x, &gamma, &beta, 32, 1e-5, act, &dy)
        });
        let (x, dy) = (x.reshape(&[n * h * w, c]), dy.reshape(&[n * h * w, c]));
        self.time(&format!("layer_norm_{name}_forward"), || layer_norm(&x, &gamma, &beta, 1e-5));
        self.time(&format!("layer_norm_{name}_backward"), || layer_norm_backward(&x, &gamma, 1e-5, &dy));
    }

    fn maps(&self) {
        let (x, y) = (noise(1, &[3072, 1024]), noise(2, &[3072, 1024]));
        self.time("add", || elementwise::add(&x, &y));
        self.time("silu", || activation::silu(&x));
        self.time("gelu", || activation::gelu(&x));
        self.time("geglu", || activation::geglu(&x));
        let image = noise(1, &[1, 128, 128, 128]);
        self.time("nchw_to_tokens", || shape::nchw_to_tokens(&image));
        self.time("upsample_nearest", || shape::upsample_nearest(&image, 2));
        let photo = noise(1, &[1, 3, 192, 256]);
        self.time("bicubic_up", || resize(&photo, 768, 1024, Filter::BicubicTorch, false));
        self.time("bicubic_down", || resize(&photo, 48, 64, Filter::BicubicTorch, true));
    }
}

fn main() {
    let bench = Bench { wanted: std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect() };
    bench.products();
    bench.convolution(1, [256, 256], [64, 64], 3, 1);
    bench.convolution(2, [96, 96], [48, 64], 3, 1);
    bench.convolution(1, [32, 32], [192, 256], 3, 1);
    bench.convolution(1, [96, 96], [48, 64], 3, 2);
    bench.convolution(2, [192, 128], [24, 32], 1, 1);
    bench.attentions(1, 4096, 4096, 8, 32);
    bench.attentions(2, 768, 768, 8, 16);
    bench.attentions(2, 3072, 77, 8, 16);
    bench.norms([1, 256, 128, 128]);
    bench.norms([2, 96, 48, 64]);
    bench.maps();
}
