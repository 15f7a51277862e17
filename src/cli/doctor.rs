//! `doctor`: which GPUs there are, which one would be used and why, and whether it computes right.
//! Changes nothing.

use clap::Args;
use compute::conv::{Conv, conv2d};
use compute::device::{Report, attempt};
use compute::linear::linear;
use compute::norm::{Activation, group_norm};
use compute::{Array, Device, GpuError, Rng, attention};
use serde_json::{Value, json};

use super::error::Error;
use super::tuning;
use crate::terminal::output::{print, print_json, size};

/// The most that the self-test may be off, of the largest number of a result.
const TOLERANCE: f32 = 1e-5;

#[derive(Args)]
pub struct Doctor {}

/// What the self-test of one adapter found.
struct Test {
    /// The operator, and how far it is off, of the largest number of its result.
    errors: Vec<(&'static str, f32)>,
    /// The tiles in which it computes matrix products: a line for each kind of them.
    tiles: String,
}

impl Doctor {
    /// Looks, tests and tells.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let adapters = Device::adapters();
        let reports = adapters.as_deref().unwrap_or_default();
        let tests: Vec<_> = reports.iter().map(|report| test(report.index)).collect();
        let choice = choice(&adapters);
        if json {
            let adapters: Vec<_> = reports
                .iter()
                .zip(&tests)
                .map(|(report, test)| as_json(report, test))
                .collect();
            let missing = adapters_missing(reports, &choice);
            print_json(&json!({
                "cpu": Device::cpu().instructions(), "adapters": adapters, "auto": choice, "missing": missing,
            }));
        } else {
            print(&format_args!(
                "CPU      {} instructions, {} threads",
                Device::cpu().instructions(),
                threads()
            ));
            reports
                .iter()
                .zip(&tests)
                .for_each(|(report, test)| tell(report, test));
            print(&format_args!("auto     {choice}"));
        }
        // An adapter that cannot be opened computes nothing wrong: it is told of, and is no
        // failure.
        let wrong = tests
            .iter()
            .filter(|test| test.as_ref().is_ok_and(|test| !test.passes()))
            .count();
        if wrong > 0 {
            let help = Some("use --device cpu, and update the driver".to_owned());
            return Err(Error::Found {
                message: format!("{wrong} GPUs compute wrong numbers"),
                help,
            });
        }
        Ok(())
    }
}

fn threads() -> usize {
    rayon::current_num_threads()
}

/// What `--device auto` takes, and why.
fn choice(adapters: &Result<Vec<Report>, GpuError>) -> String {
    let fit = |report: &&Report| report.hardware && report.unfit.is_none();
    match adapters {
        Err(error) => format!("the CPU: {error}"),
        Ok(reports) => match reports.iter().find(fit) {
            // Asked again: a GPU that would do may still refuse to be opened.
            Some(report) if Device::auto().is_gpu() => format!("gpu:{}, the first that is hardware", report.index),
            Some(report) => format!("the CPU: gpu:{} cannot be opened", report.index),
            None => {
                "the CPU: no GPU is hardware that can run the kernels; software is used only if named, as gpu:N".into()
            }
        },
    }
}

/// What is missing for a GPU, where none was found.
fn adapters_missing<'c>(reports: &[Report], choice: &'c str) -> Option<&'c str> {
    reports.is_empty().then_some(choice)
}

fn tell(report: &Report, test: &Result<Test, GpuError>) {
    let kind = if report.hardware {
        "hardware"
    } else {
        "software"
    };
    print(&format_args!(
        "gpu:{}    {}, {kind}, {} {}",
        report.index, report.name, report.backend, report.driver
    ));
    for (what, value) in &report.limits {
        let value = if what.starts_with("bytes") {
            size(*value)
        } else {
            value.to_string()
        };
        print(&format_args!("         {what}: {value}"));
    }
    for (what, has) in &report.features {
        let used = if *what == compute::device::HALVES {
            "yes"
        } else {
            "yes, not used"
        };
        print(&format_args!(
            "         {what}: {}",
            if *has { used } else { "no" }
        ));
    }
    match test {
        Err(error) => print(&format_args!("         self-test: {error}")),
        Ok(test) => {
            let verdict = if test.passes() { "passed" } else { "FAILED" };
            let errors: Vec<_> = test
                .errors
                .iter()
                .map(|(name, error)| format!("{name} {error:.0e}"))
                .collect();
            print(&format_args!(
                "         self-test {verdict}; off by: {}",
                errors.join(", ")
            ));
            print(&format_args!(
                "         tiles of products: {}",
                test.tiles.trim_end().replace('\n', "; ")
            ));
        }
    }
}

fn as_json(report: &Report, test: &Result<Test, GpuError>) -> Value {
    let named = |pairs: Vec<(&str, Value)>| {
        pairs
            .into_iter()
            .map(|(name, value)| (name.to_owned(), value))
            .collect()
    };
    let limits: serde_json::Map<_, _> = named(
        report
            .limits
            .iter()
            .map(|&(name, value)| (name, json!(value)))
            .collect(),
    );
    let features: serde_json::Map<_, _> = named(
        report
            .features
            .iter()
            .map(|&(name, has)| (name, json!(has)))
            .collect(),
    );
    let (passed, errors, fault) = match test {
        Ok(test) => (
            test.passes(),
            Some(
                test.errors
                    .iter()
                    .map(|&(name, error)| json!([name, error]))
                    .collect(),
            ),
            None,
        ),
        Err(error) => (false, None::<Vec<Value>>, Some(error.to_string())),
    };
    let tiles: Option<Vec<&str>> = test.as_ref().ok().map(|test| test.tiles.lines().collect());
    json!({
        "name": report.name, "device": format!("gpu:{}", report.index), "hardware": report.hardware,
        "backend": report.backend, "driver": report.driver, "limits": limits, "features": features,
        "unfit": report.unfit, "tiles": tiles, "self_test": { "passed": passed, "errors": errors, "fault": fault },
    })
}

impl Test {
    fn passes(&self) -> bool {
        self.errors.iter().all(|(_, error)| *error <= TOLERANCE)
    }
}

/// Computes the same on an adapter and on the CPU.
fn test(index: usize) -> Result<Test, GpuError> {
    let gpu = Device::gpu(Some(index))?;
    tuning::apply(&gpu);
    let here = results(&Device::cpu());
    // Operators return no errors: a fault of the GPU unwinds to `attempt`.
    let there = attempt(|| results(&gpu))?;
    let errors = here
        .into_iter()
        .zip(there)
        .map(|((name, here), (_, there))| (name, distance(&here, &there)));
    Ok(Test {
        errors: errors.collect(),
        tiles: gpu.tuning().unwrap_or_default(),
    })
}

/// One operator of each family, on numbers of its own generator, and a small field.
fn results(device: &Device) -> Vec<(&'static str, Vec<f32>)> {
    let rng = Rng::new(0, "doctor");
    // A step for each array, since the same step gives the same numbers.
    let random = |step, shape: &[usize]| rng.normals(step, shape, device);
    // Sizes that no power of two divides, so that the edges of a kernel's tiles are tested as well.
    let x = random(0, &[1, 24, 33, 31]);
    let tokens = random(1, &[1, 150, 48]);
    let gamma = random(2, &[24]);
    let beta = random(3, &[24]);
    let attended = attention::attention(&tokens, &tokens, &tokens, 2, false);
    let gradients =
        attention::attention_backward(&tokens, &tokens, &tokens, &attended, 2, false, &tokens);
    let results: [(&str, &Array); 5] = [
        ("linear", &linear(&tokens, random(4, &[70, 48]), None)),
        (
            "convolution",
            &conv2d(&x, random(5, &[40, 24, 3, 3]), None, Conv::padded(1)),
        ),
        (
            "group norm",
            &group_norm(&x, &gamma, &beta, 4, 1e-5, Activation::Silu),
        ),
        ("attention", &attended.out),
        ("its gradient", &gradients[0]),
    ];
    // A field has kernels of its own, which none of the operators above runs.
    let field = nerf::check(device);
    let mut results = results.map(|(name, array)| (name, array.to_vec())).to_vec();
    results.extend([("field", field.image), ("its training", field.losses)]);
    results
}

fn distance(expected: &[f32], got: &[f32]) -> f32 {
    // Never 0: a result of nothing but zeros would otherwise be off by 0 / 0.
    let size = expected
        .iter()
        .fold(f32::MIN_POSITIVE, |max, x| max.max(x.abs()));
    // NaN must count as the worst.
    let off = |(a, b): (&f32, &f32)| {
        if (a - b).is_nan() {
            f32::INFINITY
        } else {
            (a - b).abs() / size
        }
    };
    expected.iter().zip(got).map(off).fold(0.0, f32::max)
}
