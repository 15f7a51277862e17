//! The time of the main operators on the shapes of the diffusion networks, in milliseconds: the
//! least of some runs, since other programs only ever add to it. With `PYTHON` naming an
//! interpreter that has torch, PyTorch's time on the same shapes stands beside it (`ops.py`), and
//! the ratio: below 1 we are faster.
//!
//! `cargo bench -p compute [-- first word of a name ..]`. Two threads, unless `RAYON_NUM_THREADS`
//! says otherwise.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::process::Command;
use std::time::Instant;

use compute::attention::{attention, attention_backward};
use compute::conv::{Conv, conv2d, conv2d_backward_input, conv2d_backward_weight};
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm, layer_norm_backward};
use compute::resize::{Filter, resize};
use compute::{Array, Device, activation, elementwise, linear, matmul, shape};

/// Numbers in [-2, 2) that look random.
fn noise(salt: u64, shape: &[usize]) -> Array {
    let len: usize = shape.iter().product();
    let value = |i: u64| {
        ((i + salt * 7919).wrapping_mul(2_654_435_761) as u32) as f32 / (1u32 << 30) as f32 - 2.0
    };
    Device::cpu().array(shape, (0..len as u64).map(value).collect())
}

struct Bench {
    /// Only names that contain one of these run; all if there are none.
    wanted: Vec<String>,
    /// Milliseconds by name, in the order of the runs.
    times: Vec<(String, f64)>,
}

impl Bench {
    /// Whether any name that begins with `name` may be wanted.
    fn wants(&self, name: &str) -> bool {
        self.wanted.is_empty() || self.wanted.iter().any(|part| name.contains(part))
    }

    /// Notes the least time of `work`, over at least three runs and a quarter of a second.
    fn time<T>(&mut self, name: &str, mut work: impl FnMut() -> T) {
        // Once before the clock runs: caches and pools are filled then.
        black_box(work());
        let start = Instant::now();
        let mut times = Vec::new();
        while times.len() < 3 || (start.elapsed().as_secs_f64() < 0.25 && times.len() < 100) {
            let begin = Instant::now();
            black_box(work());
            times.push(begin.elapsed().as_secs_f64() * 1e3);
        }
        let least = times.into_iter().fold(f64::INFINITY, f64::min);
        self.times.push((name.to_owned(), least));
    }

    fn matmul(&mut self, [m, k, n]: [usize; 3]) {
        let a = noise(1, &[m, k]);
        let b = noise(2, &[k, n]);
        if !self.wants("matmul") {
            return;
        }
        self.time(&format!("matmul {m}x{k}x{n}"), || matmul::matmul(&a, &b));
    }

    /// A linear layer over `tokens`, forward and backward to its input; to its weight if that is an
    /// adapter's.
    fn linear(&mut self, [tokens, k, m]: [usize; 3]) {
        let name = format!("linear {tokens}x{k}-{m}");
        if !self.wants(&name) {
            return;
        }
        let x = noise(1, &[tokens, k]);
        let w = noise(2, &[m, k]);
        let dy = noise(3, &[tokens, m]);
        self.time(&format!("{name} forward"), || linear::linear(&x, &w, None));
        self.time(&format!("{name} input"), || {
            linear::linear_backward_input(&dy, &w)
        });
        if k.min(m) <= 8 {
            self.time(&format!("{name} weight"), || {
                linear::linear_backward_weight(&x, &dy)
            });
        }
    }

    fn conv(
        &mut self,
        batch: usize,
        [c, o]: [usize; 2],
        size: usize,
        kernel: usize,
        stride: usize,
    ) {
        let pad = if stride == 1 {
            [kernel / 2; 4]
        } else {
            [0, 1, 0, 1]
        };
        let conv = Conv { stride, pad };
        let name = format!("conv{kernel}s{stride} {batch}x{c}-{o} {size}x{size}");
        if !self.wants(&name) {
            return;
        }
        let x = noise(1, &[batch, c, size, size]);
        let weight = noise(2, &[o, c, kernel, kernel]);
        let dy = conv2d(&x, &weight, None, conv);
        self.time(&format!("{name} forward"), || {
            conv2d(&x, &weight, None, conv)
        });
        self.time(&format!("{name} input"), || {
            conv2d_backward_input(&dy, &weight, conv, [size; 2])
        });
        if c * o <= 1 << 14 {
            self.time(&format!("{name} weight"), || {
                conv2d_backward_weight(&x, &dy, conv, [kernel; 2])
            });
        }
    }

    fn attention(&mut self, batch: usize, [tokens, keys]: [usize; 2], [heads, depth]: [usize; 2]) {
        let name = format!("attention {batch}x{tokens}-{keys} {heads}x{depth}");
        if !self.wants(&name) {
            return;
        }
        let q = noise(1, &[batch, tokens, heads * depth]);
        let [k, v] = [2, 3].map(|salt| noise(salt, &[batch, keys, heads * depth]));
        let attended = attention(&q, &k, &v, heads, false);
        self.time(&format!("{name} forward"), || {
            attention(&q, &k, &v, heads, false)
        });
        self.time(&format!("{name} backward"), || {
            attention_backward(&q, &k, &v, &attended, heads, false, &q)
        });
    }

    fn norms(&mut self, batch: usize, c: usize, size: usize, groups: usize) {
        let extents = [batch, c, size, size];
        if !self.wants("norm") {
            return;
        }
        let x = noise(1, &extents);
        let dy = noise(2, &extents);
        let gamma = noise(3, &[c]);
        let beta = noise(4, &[c]);
        let act = Activation::Silu;
        let name = format!("{batch}x{c} {size}x{size}");
        self.time(&format!("group_norm_silu {name} forward"), || {
            group_norm(&x, &gamma, &beta, groups, 1e-5, act)
        });
        self.time(&format!("group_norm_silu {name} backward"), || {
            group_norm_backward(&x, &gamma, &beta, groups, 1e-5, act, &dy)
        });
        let x = x.reshape(&[batch * size * size, c]);
        let dy = dy.reshape(&[batch * size * size, c]);
        self.time(&format!("layer_norm {name} forward"), || {
            layer_norm(&x, &gamma, &beta, 1e-5)
        });
        self.time(&format!("layer_norm {name} backward"), || {
            layer_norm_backward(&x, &gamma, 1e-5, &dy)
        });
    }

    fn maps(&mut self) {
        if !self.wants("map") {
            return;
        }
        let x = noise(1, &[1024, 4096]);
        let y = noise(2, &[1024, 4096]);
        let half = noise(3, &[1024, 2048]);
        self.time("map: add 1024x4096", || elementwise::add(&x, &y));
        self.time("map: silu 1024x4096", || activation::silu(&x));
        self.time("map: gelu 1024x4096", || activation::gelu(&x));
        self.time("map: geglu 1024x4096 forward", || activation::geglu(&x));
        self.time("map: geglu 1024x4096 backward", || {
            activation::geglu_backward(&x, &half)
        });
        let image = noise(1, &[1, 256, 64, 64]);
        self.time("map: nchw_to_tokens 1x256 64x64", || {
            shape::nchw_to_tokens(&image)
        });
        self.time("map: concat 1x256+256 64x64", || {
            shape::concat(&[&image, &image], 1)
        });
        self.time("map: upsample_nearest 1x256 64x64", || {
            shape::upsample_nearest(&image, 2)
        });
        let photo = noise(1, &[1, 3, 192, 256]);
        self.time("map: bicubic 192x256-768x1024", || {
            resize(&photo, 768, 1024, Filter::BicubicTorch, false)
        });
        self.time("map: bicubic 192x256-48x64", || {
            resize(&photo, 48, 64, Filter::BicubicTorch, true)
        });
    }

    /// The upscaler at 64x64 latents, then tiny-x4 at 32x32 with a batch of four, then their
    /// autoencoders.
    fn all(&mut self) {
        self.matmul([1024, 1024, 1024]);
        for extents in [
            [1024, 512, 4096],
            [1024, 2048, 512],
            [64, 1024, 8192],
            [1024, 512, 4],
            [1024, 4, 512],
        ] {
            self.linear(extents);
        }
        for extents in [[1024, 96, 768], [256, 128, 128], [1024, 96, 4]] {
            self.linear(extents);
        }
        for (channels, size) in [
            ([256; 2], 64),
            ([768, 256], 64),
            ([512; 2], 32),
            ([512; 2], 16),
            ([1024; 2], 8),
        ] {
            self.conv(1, channels, size, 3, 1);
        }
        self.conv(2, [1024; 2], 8, 3, 1);
        self.conv(1, [256; 2], 64, 3, 2);
        self.conv(1, [768, 256], 64, 1, 1);
        for (channels, size) in [([19, 64], 32), ([64; 2], 32), ([96; 2], 16), ([128; 2], 8)] {
            self.conv(4, channels, size, 3, 1);
        }
        self.conv(4, [64; 2], 32, 3, 2);
        self.conv(1, [512; 2], 64, 3, 1);
        self.conv(1, [128; 2], 256, 3, 1);
        self.conv(4, [32; 2], 128, 3, 1);
        self.conv(1, [128, 3], 256, 3, 1);
        self.attention(1, [4096, 4096], [1, 512]);
        self.attention(1, [4096, 4096], [8, 32]);
        self.attention(1, [1024, 77], [8, 64]);
        self.attention(4, [256, 256], [4, 24]);
        self.norms(1, 256, 64, 32);
        self.norms(1, 128, 256, 32);
        self.norms(4, 64, 32, 16);
        self.maps();
    }
}

/// What `ops.py` prints for the same names: milliseconds by name, and a line on versions and
/// threads.
fn torch(python: &str, wanted: &[String]) -> (BTreeMap<String, f64>, String) {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/ops.py");
    let output = Command::new(python)
        .arg(script)
        .args(wanted)
        .output()
        .expect("PYTHON runs");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let text = String::from_utf8_lossy(&output.stdout);
    let (versions, rows) = text.split_once('\n').expect("a first line");
    let row = |line: &str| {
        line.split_once('\t')
            .map(|(name, ms)| (name.to_owned(), ms.parse().expect("a number")))
    };
    (rows.lines().filter_map(row).collect(), versions.to_owned())
}

fn main() {
    let threads = std::env::var("RAYON_NUM_THREADS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(2);
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .expect("a pool of threads");
    let wanted = std::env::args()
        .skip(1)
        .filter(|arg| !arg.starts_with('-'))
        .collect();
    let mut bench = Bench {
        wanted,
        times: Vec::new(),
    };
    bench.all();
    let Some(python) = std::env::var("PYTHON")
        .ok()
        .filter(|python| !python.is_empty())
    else {
        bench
            .times
            .iter()
            .for_each(|(name, ms)| println!("{name:44} {ms:9.3} ms"));
        return;
    };
    let (torch, versions) = torch(&python, &bench.wanted);
    let instructions = Device::cpu().instructions();
    println!(
        "compute {}, {instructions}, {threads} threads; {versions}",
        env!("CARGO_PKG_VERSION")
    );
    println!("| operator and shape | ours, ms | PyTorch, ms | ours / PyTorch |\n|---|---|---|---|");
    for (name, ms) in &bench.times {
        match torch.get(name) {
            Some(theirs) => println!("| {name} | {ms:.3} | {theirs:.3} | {:.2} |", ms / theirs),
            None => println!("| {name} | {ms:.3} | | |"),
        }
    }
}
