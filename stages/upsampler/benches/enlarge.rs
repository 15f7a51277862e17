//! Prints the time that the embedded network takes for a megapixel of its result, in tiles and as a
//! whole, with one thread and with two: `enlarge.py` beside this file puts PyTorch's beside it,
//! where `PYTHON` names one that has torch.
//!
//! Both run in turns, and the least time of each counts, since other programs only ever add to it.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use compute::{Device, Rng};
use upsampler::{Options, Upsampler, UpsamplerError, UpsamplerSource};

const RUNS: usize = 7;
/// A megapixel four times smaller.
const SIDE: usize = 256;

/// PyTorch in a process of its own, which runs once for every line that it is sent.
struct Torch(Child);

impl Torch {
    fn start(threads: usize) -> Option<Torch> {
        let python = std::env::var("PYTHON")
            .ok()
            .filter(|name| !name.is_empty())?;
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/enlarge.py");
        let child = Command::new(python)
            .args([script, &SIDE.to_string(), &threads.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn();
        child.ok().map(Torch)
    }

    /// The milliseconds of one run, in the faster of two memory layouts; none if it has failed.
    fn run(&mut self) -> Option<f64> {
        writeln!(self.0.stdin.as_mut()?).ok()?;
        let mut said = String::new();
        // It says no more than a line at a time, so nothing is lost with the reader.
        BufReader::new(self.0.stdout.as_mut()?)
            .read_line(&mut said)
            .ok()?;
        said.trim().parse().ok()
    }
}

impl Drop for Torch {
    fn drop(&mut self) {
        // Without its input it ends by itself.
        drop(self.0.stdin.take());
        let _ = self.0.wait();
    }
}

fn milliseconds(run: impl Fn()) -> f64 {
    let start = Instant::now();
    run();
    start.elapsed().as_secs_f64() * 1e3
}

/// Times the network in a pool of so many threads.
fn compare(network: &Upsampler, threads: usize) {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("a pool of threads");
    let image = Rng::new(0, "timing").normals(0, &[1, 3, SIDE, SIDE], &Device::cpu());
    let ensemble = false;
    let enlarge = |tile| pool.install(|| drop(network.enlarge(&image, Options { tile, ensemble })));
    let mut torch = Torch::start(threads);
    let [mut whole, mut tiled, mut theirs] = [f64::INFINITY; 3];
    for _ in 0..RUNS {
        whole = whole.min(milliseconds(|| enlarge(SIDE)));
        tiled = tiled.min(milliseconds(|| enlarge(SIDE / 2)));
        let time = torch.as_mut().and_then(Torch::run);
        theirs = theirs.min(time.unwrap_or(f64::INFINITY));
    }
    println!("{threads} threads: {whole:.0} ms, in tiles of 128 {tiled:.0} ms");
    if theirs.is_finite() {
        let ratio = whole / theirs;
        println!("  PyTorch, the faster of two memory layouts: {theirs:.0} ms; ratio {ratio:.2}");
    } else if torch.is_some() {
        println!("  PyTorch's time could not be had");
    }
}

fn main() -> Result<(), UpsamplerError> {
    let network = Upsampler::load(&UpsamplerSource::Embedded, &Device::cpu())?;
    println!("embedded upsampler, {SIDE}x{SIDE} to four times the side");
    for threads in [1, 2] {
        compare(&network, threads);
    }
    Ok(())
}
