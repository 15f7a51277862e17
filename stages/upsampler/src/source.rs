//! Where an upsampler's files come from: the program itself, or a path. Hands out named bytes;
//! knows which files belong together, not what stands in them.

use std::path::{Path, PathBuf};

use formats::{FileBytes, FileError};

use crate::error::UpsamplerError;

/// The network that the program carries.
const EMBEDDED: &[u8] = include_bytes!("../models/residual-x4.safetensors");

/// The name of the embedded network, as it is printed.
pub const EMBEDDED_NAME: &str = "residual-x4";

/// Where an upsampler is read from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UpsamplerSource {
    /// The network that the program carries.
    Embedded,
    /// A `.safetensors` file; or either file of an ncnn pair, `.param` and `.bin`, the other of
    /// which lies beside it.
    File(PathBuf),
}

fn read(path: &Path) -> Result<FileBytes, UpsamplerError> {
    FileBytes::read(path).map_err(|error| match error {
        FileError::Missing { file } => missing(path, &file),
        other => other.into(),
    })
}

/// Says which file of a pair is not there.
fn missing(path: &Path, name: &str) -> UpsamplerError {
    let other = match ending(path).as_str() {
        "bin" => Some("param"),
        "param" => Some("bin"),
        _ => None,
    };
    let problem = match other
        .map(|other| path.with_extension(other))
        .filter(|other| other.exists())
    {
        // The other file's presence shows that a pair was meant.
        Some(other) => format!(
            "is missing; {} beside it is only half of an ncnn network",
            other.display()
        ),
        None => "is missing".to_owned(),
    };
    UpsamplerError::file(name, problem)
}

fn ending(path: &Path) -> String {
    path.extension()
        .map(|ending| ending.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default()
}

/// How a pickle becomes a file that is read here.
// A pickle is refused and never loaded: reading one can run any code.
const PICKLE: &str = "is a pickle, which can run any code when it is read; where you trust it, convert it:\n\
    python3 -c 'import sys, torch, safetensors.torch as s; d = torch.load(sys.argv[1], map_location=\"cpu\", weights_only=True)\n\
    d = d.get(\"params_ema\", d.get(\"params\", d)); s.save_file({k: v.contiguous() for k, v in d.items()}, sys.argv[2])' IN.pth OUT.safetensors";

impl UpsamplerSource {
    /// The files that it consists of, beside this program.
    pub fn paths(&self) -> Vec<PathBuf> {
        match self {
            Self::Embedded => Vec::new(),
            Self::File(path) => match ending(path).as_str() {
                "param" | "bin" => ["param", "bin"]
                    .map(|ending| path.with_extension(ending))
                    .into(),
                _ => vec![path.clone()],
            },
        }
    }

    /// Its files: one, or an ncnn network's graph and weights. Fails where one is missing, and
    /// where none can be read by what its name ends with.
    pub fn files(&self) -> Result<Vec<FileBytes>, UpsamplerError> {
        let Self::File(path) = self else {
            let name = format!("{EMBEDDED_NAME}.safetensors");
            return Ok(vec![FileBytes::embedded(name, EMBEDDED)]);
        };
        let problem = match ending(path).as_str() {
            "safetensors" | "param" | "bin" => {
                return self.paths().iter().map(|path| read(path)).collect();
            }
            "pth" | "pt" | "ckpt" => PICKLE,
            _ => {
                "is no upsampler that is read here: those are .safetensors, and .param with .bin of ncnn"
            }
        };
        Err(UpsamplerError::file(&path.display().to_string(), problem))
    }

    /// A digest of what is in the files: the same wherever they lie.
    pub fn digest(&self) -> Result<[u8; 32], UpsamplerError> {
        // A key of its own, so that no other digest of the same bytes can be equal.
        let mut hasher = blake3::Hasher::new_derive_key("srnerf-dag 1 upsampler files");
        for file in self.files()? {
            // Lengths keep two files apart: moving a byte from one to the other changes the digest.
            hasher.update(&(file.len() as u64).to_le_bytes());
            hasher.update(&file);
        }
        Ok(*hasher.finalize().as_bytes())
    }
}
