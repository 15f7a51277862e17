//! The main operators on a GPU, on the shapes of the x4 upscaler: what each gives the device to do,
//! how long it takes, and how that compares with the roofline, the time that the arithmetic or the
//! memory would take alone.
//!
//! `make bench-gpu [GPU=1] [PEAK=82600,1008]`: GPU is the number that `srnerf-dag doctor` gives an
//! adapter, by default the first that is hardware; PEAK the GPU's GFLOP/s and GB/s by its data
//! sheet, by default those of an RTX 4090 (GeForce). With GPU=counts nothing runs, and only what
//! would be done is printed; for that a driver of software is enough.

use std::time::Instant;

use compute::attention::{attention, attention_backward};
use compute::conv::{Conv, conv2d, conv2d_backward_input};
use compute::linear::{linear, linear_backward_input, linear_backward_weight};
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm};
use compute::{Array, Counts, Device, activation, elementwise};

/// Giga-operations and gigabytes per second.
struct Peak {
    operations: f64,
    bytes: f64,
}

struct Bench {
    device: Device,
    peak: Peak,
    runs: bool,
}

impl Bench {
    /// Zeros: no kernel's time depends on the numbers.
    fn array(&self, shape: &[usize]) -> Array {
        self.device.zeros(shape)
    }

    fn counts(&self) -> Counts {
        self.device.counts().unwrap_or_default()
    }

    /// One row of the table.
    fn row<T>(&self, name: &str, work: impl Fn() -> T) {
        let before = self.counts();
        // Compiles the kernels as well, so that the timing below does not.
        work();
        let done = self.counts() - before;
        let operations = done.operations as f64 * 1e-9;
        let bytes = done.bytes as f64 * 1e-9;
        let roof = 1e3 * (operations / self.peak.operations).max(bytes / self.peak.bytes);
        print!(
            "| {name} | {} | {operations:.2} | {:.1} | {roof:.3} |",
            done.dispatches,
            1e3 * bytes
        );
        if self.runs {
            let time = self.time(work);
            let speed = operations / time * 1e3;
            print!(
                " {time:.3} | {speed:.0} | {:.0} | {:.2} |",
                bytes / time * 1e3,
                roof / time
            );
        }
        println!();
    }

    /// The least milliseconds per piece of work, of several times ten handed over together.
    fn time<T>(&self, work: impl Fn() -> T) -> f64 {
        self.device.finish();
        let once = || {
            let begin = Instant::now();
            (0..10).for_each(|_| drop(work()));
            self.device.finish();
            // Milliseconds of one of the ten.
            begin.elapsed().as_secs_f64() * 1e2
        };
        (0..5).map(|_| once()).fold(f64::INFINITY, f64::min)
    }

    fn linear(&self, [rows, k, m]: [usize; 3]) {
        let x = self.array(&[rows, k]);
        let w = self.array(&[m, k]);
        let dy = self.array(&[rows, m]);
        self.row(&format!("linear {rows}x{k}-{m}"), || linear(&x, &w, None));
        self.row("its gradient to the input", || {
            linear_backward_input(&dy, &w)
        });
        if k.min(m) <= 8 {
            self.row("its gradient to the weight", || {
                linear_backward_weight(&x, &dy)
            });
        }
    }

    fn conv(&self, c: usize, o: usize, side: usize) {
        let x = self.array(&[1, c, side, side]);
        let w = self.array(&[o, c, 3, 3]);
        let dy = self.array(&[1, o, side, side]);
        self.row(&format!("3x3 convolution {c}-{o}, {side}x{side}"), || {
            conv2d(&x, &w, None, Conv::padded(1))
        });
        self.row("its gradient to the input", || {
            conv2d_backward_input(&dy, &w, Conv::padded(1), [side; 2])
        });
    }

    fn attention(&self, queries: usize, keys: usize, heads: usize, depth: usize) {
        let [q, k] = [queries, keys].map(|tokens| self.array(&[1, tokens, heads * depth]));
        let attended = attention(&q, &k, &k, heads, false);
        self.row(
            &format!("attention {queries}-{keys}, {heads}x{depth}"),
            || attention(&q, &k, &k, heads, false),
        );
        self.row("its gradients", || {
            attention_backward(&q, &k, &k, &attended, heads, false, &q)
        });
    }

    fn others(&self, c: usize, side: usize) {
        let x = self.array(&[1, c, side, side]);
        let gamma = self.array(&[c]);
        let silu = Activation::Silu;
        self.row(&format!("group norm and SiLU {c}, {side}x{side}"), || {
            group_norm(&x, &gamma, &gamma, 32, 1e-5, silu)
        });
        self.row("its gradient", || {
            group_norm_backward(&x, &gamma, &gamma, 32, 1e-5, silu, &x)
        });
        let tokens = self.array(&[side * side, c]);
        self.row(&format!("layer norm {}x{c}", side * side), || {
            layer_norm(&tokens, &gamma, &gamma, 1e-5)
        });
        let wide = self.array(&[side * side, 8 * c]);
        self.row(&format!("GEGLU {}x{}", side * side, 8 * c), || {
            activation::geglu(&wide)
        });
        self.row(&format!("sum {c}, {side}x{side}"), || {
            elementwise::add(&x, &x)
        });
    }
}

fn main() {
    let gpu = std::env::var("GPU").unwrap_or_default();
    let runs = gpu != "counts";
    let number = if runs { gpu.parse().ok() } else { Some(0) };
    let device = Device::gpu(number).unwrap_or_else(|error| {
        eprintln!("nothing to measure: {error}");
        std::process::exit(if gpu.is_empty() { 0 } else { 2 })
    });
    let peak = std::env::var("PEAK").unwrap_or_else(|_| "82600,1008".into());
    let mut peak = peak.split(',').filter_map(|figure| figure.parse().ok());
    let peak = Peak {
        operations: peak.next().unwrap_or(82_600.0),
        bytes: peak.next().unwrap_or(1008.0),
    };
    println!(
        "{}\n",
        if runs {
            device.kind()
        } else {
            "counts only: nothing runs"
        }
    );
    print!("| operator | dispatches | GFLOP | MB | roofline ms |");
    println!(
        "{}",
        if runs {
            " ms | GFLOP/s | GB/s | of the roofline |"
        } else {
            ""
        }
    );
    println!(
        "|---|---|---|---|---|{}",
        if runs { "---|---|---|---|" } else { "" }
    );
    let bench = Bench { device, peak, runs };
    for extents in [
        [4096, 256, 2048],
        [1024, 512, 4096],
        [1024, 2048, 512],
        [1024, 512, 4],
    ] {
        bench.linear(extents);
    }
    for (channels, outputs, side) in [
        (256, 256, 64),
        (768, 256, 64),
        (512, 512, 32),
        (1024, 1024, 8),
    ] {
        bench.conv(channels, outputs, side);
    }
    bench.attention(4096, 4096, 8, 32);
    bench.attention(1024, 77, 8, 64);
    bench.others(256, 64);
}
