//! Prints the time that the embedded network takes for a megapixel of its result, in tiles and as a whole: `enlarge.py`
//! beside this file puts PyTorch's beside it, where `PYTHON` names one that has torch.

use std::process::Command;
use std::time::Instant;

use compute::{Device, Rng};
use upsampler::{Options, Upsampler, UpsamplerError, UpsamplerSource};

const RUNS: usize = 5;
/// A megapixel four times smaller.
const SIDE: usize = 256;

/// The median of some runs, in milliseconds.
fn median(run: impl Fn()) -> f64 {
    let time = |_| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64() * 1e3
    };
    let mut times: Vec<f64> = (0..RUNS).map(time).collect();
    times.sort_by(f64::total_cmp);
    times[RUNS / 2]
}

fn main() -> Result<(), UpsamplerError> {
    let device = Device::cpu();
    let network = Upsampler::load(&UpsamplerSource::Embedded, &device)?;
    let image = Rng::new(0, "timing").normals(0, &[1, 3, SIDE, SIDE], &device);
    let ours = [SIDE, SIDE / 2].map(|tile| {
        median(|| {
            drop(network.enlarge(
                &image,
                Options {
                    tile,
                    ensemble: false,
                },
            ))
        })
    });
    println!(
        "embedded upsampler, {SIDE}x{SIDE} to four times the side: {:.0} ms, in tiles of 128 {:.0} ms",
        ours[0], ours[1]
    );
    let python = std::env::var("PYTHON").unwrap_or_default();
    if !python.is_empty() {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/enlarge.py");
        let theirs = Command::new(python)
            .args([script, &SIDE.to_string(), &RUNS.to_string()])
            .output();
        let said = theirs
            .map(|output| String::from_utf8_lossy(&output.stdout).into_owned())
            .unwrap_or_default();
        match said.trim().parse::<f64>() {
            Ok(theirs) => {
                println!(
                    "PyTorch, the faster of two memory layouts: {theirs:.0} ms; ratio {:.2}",
                    ours[0] / theirs
                )
            }
            Err(_) => println!("PyTorch's time could not be had: {said:?}"),
        }
    }
    Ok(())
}
