//! `model run`: asks one network of a model about the tensors of a file. Writes the file of
//! results, whole or not at all.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use compute::device::attempt;
use compute::{Counts, Device, Precision};
use diffusion::ModelError;
use diffusion::call::{Asked, Call, Outputs, Part, to_safetensors};
use formats::{FileBytes, TensorFile};
use serde_json::json;
use upsampler::Options;

use super::error::Error;
use super::upsample::Enlargement;
use super::{device, model_check, tuning, whole};
use crate::terminal::output::{print, print_json, size};

/// Options of `model run`.
#[derive(Args)]
pub struct Run {
    /// The model's folder, in the layout of diffusers, or the x4 upscaler's single .safetensors; for
    /// an upsampler its file: .safetensors, or either of ncnn's .param and .bin; or `embedded`, for
    /// what the program carries
    model: PathBuf,
    /// Which network
    #[arg(long)]
    part: PartName,
    /// The tensors to ask about, .safetensors; their names are those of diffusers' arguments
    #[arg(long, required_unless_present = "prompt")]
    input: Option<PathBuf>,
    /// The text to ask about, in place of --input
    #[arg(long, conflicts_with = "input")]
    prompt: Option<String>,
    /// Where to write the results, .safetensors
    #[arg(long)]
    output: PathBuf,
    /// A LoRA of the UNet, as diffusers and PEFT write it
    #[arg(long)]
    lora: Option<PathBuf>,
    /// Also the mean squared error to the tensor `target`, and its gradients by the sample and the
    /// LoRA's tensors
    #[arg(long)]
    target_grad: bool,
    /// How many megabytes of activations the way back may keep; the rest is computed again
    #[arg(long, default_value_t = 64, value_name = "MB")]
    keep: usize,
    /// How the UNet multiplies; bf16 is off by some 2e-3 of a product's norm
    #[arg(long, value_enum, default_value = "f32")]
    precision: PrecisionName,
    /// Where to compute: auto, cpu, gpu or gpu:N; a GPU multiplies in f32
    #[arg(long, default_value = "auto")]
    device: String,
    /// The side of the tiles of an upsampler, in pixels of the image
    #[arg(long, default_value_t = 256, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(128..=8192))]
    tile: u32,
    /// Enlarge in eight ways, turned and mirrored, and take the mean
    #[arg(long)]
    ensemble: bool,
    /// Also print the median time of so many passes, and the peak memory
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    repeat: Option<u32>,
    /// How many threads compute; by default one per core
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    threads: usize,
}

#[derive(Clone, Copy, ValueEnum)]
enum PrecisionName {
    F32,
    Bf16,
}

#[derive(Clone, Copy, ValueEnum)]
enum PartName {
    Unet,
    VaeEncode,
    VaeDecode,
    Text,
    Upsample,
}

/// The tensors of a file, which stays mapped.
fn open(path: &Path) -> Result<TensorFile, ModelError> {
    Ok(TensorFile::new(FileBytes::map(path)?)?)
}

impl From<PrecisionName> for Precision {
    fn from(name: PrecisionName) -> Precision {
        match name {
            PrecisionName::F32 => Precision::F32,
            PrecisionName::Bf16 => Precision::Bf16,
        }
    }
}

impl PartName {
    /// The part of a diffusion model; none where this is no such.
    fn of_diffusion(self) -> Option<Part> {
        match self {
            PartName::Unet => Some(Part::Unet),
            PartName::VaeEncode => Some(Part::VaeEncode),
            PartName::VaeDecode => Some(Part::VaeDecode),
            PartName::Text => Some(Part::Text),
            PartName::Upsample => None,
        }
    }
}

/// A network with what it is asked.
enum Question {
    Diffusion(Call),
    Upsample(Enlargement),
}

impl Question {
    fn forward(&self) -> Outputs {
        match self {
            Self::Diffusion(call) => call.forward(),
            Self::Upsample(enlargement) => enlargement.forward(),
        }
    }

    fn gradients(&self) -> Option<Outputs> {
        match self {
            Self::Diffusion(call) => call.gradients(),
            Self::Upsample(_) => None,
        }
    }
}

/// What a network answered, and what that took.
struct Answer {
    outputs: Outputs,
    bytes: Vec<u8>,
    /// What the first pass gave a GPU to do, the weights' way to it included.
    counts: Option<Counts>,
    times: Option<Times>,
}

/// Milliseconds, and the process's largest memory in bytes where the system tells.
struct Times {
    forward: f64,
    with_backward: Option<f64>,
    peak_memory: Option<u64>,
}

impl Run {
    /// Asks the network, writes its answer, and prints what was asked for.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let device = device::open(&self.device)?;
        if device.is_gpu() && matches!(self.precision, PrecisionName::Bf16) {
            return Err(Error::usage(
                "a GPU multiplies in f32 only",
                "leave --precision out, or give --device cpu",
            ));
        }
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads)
            .build();
        let pool = pool.map_err(|error| Error::usage(error.to_string(), "try fewer --threads"))?;
        tuning::apply(&device);
        // Operators return no errors: a fault of the GPU unwinds to `attempt`.
        let computed = pool.install(|| attempt(|| self.compute(&device)));
        let answer = computed.map_err(|fault| Error::Failed(fault.to_string()))??;
        whole::file(&self.output, |out| out.write_all(&answer.bytes))?;
        self.report(&answer, &device, json);
        Ok(())
    }

    fn compute(&self, device: &Device) -> Result<Answer, Error> {
        let call = self.question(device)?;
        let before = device.counts();
        // With gradients comes the forward pass, so it need not be asked for twice.
        let outputs = call.gradients().unwrap_or_else(|| call.forward());
        let bytes = to_safetensors(&outputs)?;
        // Before the passes that are timed, which would be counted as well.
        let counts = device
            .counts()
            .zip(before)
            .map(|(after, before)| after - before);
        let pass = |forward_only: bool| {
            drop(if forward_only {
                Some(call.forward())
            } else {
                call.gradients()
            });
            // A GPU goes on after its calls have returned: without waiting, only their submission
            // is timed.
            device.finish();
        };
        let times = self.repeat.map(|count| Times {
            forward: median(count, || pass(true)),
            with_backward: self.target_grad.then(|| median(count, || pass(false))),
            // The last field, since fields are evaluated in this order: it covers all passes above.
            peak_memory: peak_memory(),
        });
        Ok(Answer {
            outputs,
            bytes,
            counts,
            times,
        })
    }

    fn question(&self, device: &Device) -> Result<Question, Error> {
        match self.part.of_diffusion() {
            Some(part) => Ok(Question::Diffusion(self.call(part, device)?)),
            None => Ok(Question::Upsample(self.enlargement(device)?)),
        }
    }

    fn enlargement(&self, device: &Device) -> Result<Enlargement, Error> {
        let only = |what: &str| Error::usage(format!("an upsampler has no {what}"), "leave it out");
        let Some(input) = &self.input else {
            return Err(only("--prompt"));
        };
        if self.lora.is_some() || self.target_grad {
            return Err(only("LoRA and no gradients"));
        }
        let options = Options {
            tile: self.tile as usize,
            ensemble: self.ensemble,
        };
        Enlargement::new(&self.model, &open(input)?, options, device)
    }

    fn call(&self, part: Part, device: &Device) -> Result<Call, Error> {
        let source = model_check::diffusion_source(&self.model);
        if (self.lora.is_some() || self.target_grad) && part != Part::Unet {
            return Err(Error::usage(
                "only the UNet has a LoRA and gradients",
                "give --part unet, or leave them out",
            ));
        }
        match (&self.prompt, &self.input) {
            (Some(_), _) if part != Part::Text => Err(Error::usage(
                "only the text encoder reads a prompt",
                "give --part text",
            )),
            (Some(prompt), _) => Ok(Call::prompt(&source, prompt, device)?),
            (None, Some(input)) => {
                let asked = Asked {
                    lora: self.lora.as_deref(),
                    gradients: self.target_grad,
                    kept: self.keep.saturating_mul(1 << 20),
                    precision: self.precision.into(),
                };
                Ok(Call::new(&source, part, &open(input)?, &asked, device)?)
            }
            (None, None) => Err(Error::usage(
                "there is nothing to ask about",
                "give --input or --prompt",
            )),
        }
    }

    fn report(&self, answer: &Answer, device: &Device, json: bool) {
        let times = answer.times.as_ref();
        if json {
            let shapes: serde_json::Map<_, _> = answer
                .outputs
                .iter()
                .map(|(name, output)| (name.clone(), json!(output.shape())))
                .collect();
            print_json(&json!({
                "output": self.output, "tensors": shapes, "device": device.kind(),
                "counts": answer.counts.map(device::counts),
                "forward_ms": times.map(|times| times.forward),
                "forward_backward_ms": times.and_then(|times| times.with_backward),
                "peak_memory_bytes": times.and_then(|times| times.peak_memory),
            }));
            return;
        }
        let Some(times) = times else { return };
        print(&format_args!(
            "forward                {:.1} ms",
            times.forward
        ));
        if let Some(time) = times.with_backward {
            print(&format_args!("forward and backward   {time:.1} ms"));
        }
        if let Some(bytes) = times.peak_memory {
            print(&format_args!("peak memory            {}", size(bytes)));
        }
    }
}

/// The median time of `count` runs, in milliseconds.
fn median(count: u32, run: impl Fn()) -> f64 {
    let time = |_| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64() * 1e3
    };
    let mut times: Vec<f64> = (0..count).map(time).collect();
    times.sort_by(f64::total_cmp);
    // The median, since a single pass that the system held up would distort a mean.
    let middle = times.len() / 2;
    if times.len() % 2 == 1 {
        times[middle]
    } else {
        (times[middle - 1] + times[middle]) / 2.0
    }
}

/// The most memory that this process has had resident so far, where the system keeps count of it.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().trim_end_matches(" kB").parse().ok()?;
    Some(kilobytes * 1024)
}
