//! The upsampler of `model check` and `model run`: what its file holds, and images enlarged by it.
//! Writes nothing.

use std::path::Path;

use compute::{Array, Device};
use diffusion::ModelError;
use diffusion::call::{Output, Outputs};
use formats::TensorFile;
use serde_json::json;
use sha2::{Digest, Sha256};
use upsampler::{Options, Upsampler, UpsamplerSource};

use super::error::Error;
use super::model_check::{hex, is_embedded};
use crate::terminal::output::{print, print_json, size, table};

/// Images and what enlarges them.
pub struct Enlargement {
    network: Upsampler,
    images: Array,
    options: Options,
}

fn source(model: &Path) -> UpsamplerSource {
    if is_embedded(model) {
        UpsamplerSource::Embedded
    } else {
        UpsamplerSource::File(model.to_owned())
    }
}

impl Enlargement {
    /// The upsampler `model`, and the tensor `sample [N, 3, H, W]` of a file.
    pub fn new(
        model: &Path,
        inputs: &TensorFile,
        options: Options,
        device: &Device,
    ) -> Result<Self, Error> {
        let network = Upsampler::load(&source(model), device)?;
        let images = diffusion::array(inputs, "sample", device)?;
        // An empty tensor has a right shape too, and nothing in it to enlarge.
        if matches!(*images.shape(), [n, 3, h, w] if n * h * w > 0) {
            return Ok(Self {
                network,
                images,
                options,
            });
        }
        let problem = format!("has the shape {:?}; expected [*, 3, *, *]", images.shape());
        Err(ModelError::from(inputs.wrong("sample", problem)).into())
    }

    /// The images, enlarged, as `sample`.
    pub fn forward(&self) -> Outputs {
        Outputs::from([(
            "sample".to_owned(),
            Output::Real(self.network.enlarge(&self.images, self.options)),
        )])
    }
}

/// Reads an upsampler whole, and prints what it is.
pub fn check(model: &Path, json: bool) -> Result<(), Error> {
    let source = source(model);
    let network = Upsampler::load(&source, &Device::cpu())?;
    let about = network.inventory();
    let [weights, tile] = network.memory(Options::default().tile);
    let sha256 = |bytes: &[u8]| hex(&Sha256::digest(bytes));
    let files: Vec<_> = source
        .files()?
        .iter()
        .map(|f| (f.name().to_owned(), f.len() as u64, sha256(f)))
        .collect();
    let digest = hex(&source.digest()?);
    if json {
        let files: Vec<_> = files
            .iter()
            .map(|(name, bytes, sha256)| json!({"file": name, "bytes": bytes, "sha256": sha256}))
            .collect();
        let part = json!({
            "part": "upsample", "family": about.family, "scale": about.scale, "width": about.width, "depth": about.depth,
            "reach": about.reach, "margin": about.margin, "tensors": about.tensors, "parameters": about.parameters,
            "types": about.types, "memory_bytes": weights, "tile_bytes": tile,
        });
        print_json(&json!({"model": model, "parts": [part], "files": files, "digest": digest}));
        return Ok(());
    }
    let head = [
        "part",
        "family",
        "scale",
        "width",
        "depth",
        "tensors",
        "parameters",
        "stored as",
        "memory",
    ];
    let types: Vec<&str> = about.types.keys().map(String::as_str).collect();
    let row = [
        "upsample".to_owned(),
        about.family.to_owned(),
        format!("x{}", about.scale),
        about.width.to_string(),
        about.depth.clone(),
        about.tensors.to_string(),
        format!("{:.2} M", about.parameters as f64 / 1e6),
        types.join(", "),
        size(weights),
    ];
    print(&table(
        &[head.map(str::to_owned).to_vec(), row.to_vec()],
        false,
    ));
    let rows: Vec<Vec<String>> = files
        .into_iter()
        .map(|(name, bytes, digest)| vec![digest, size(bytes), name])
        .collect();
    print(&format_args!("\nsha256\n{}", table(&rows, false)));
    print(&format_args!(
        "\nIts digest in a stage's key is {digest}.\nAn input changes pixels up to {} pixels away; a tile of 256x256 with margins of {} takes {} of memory, roughly.",
        about.reach,
        about.margin,
        size(tile)
    ));
    Ok(())
}
