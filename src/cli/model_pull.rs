//! `model pull`: gets a model from the Hugging Face hub into the hub's own cache, which Python's
//! libraries share.
//!
//! Only the files that a run reads, each checked against the digest that the hub names it by. A
//! download that was cut off goes on where it stopped. HF_ENDPOINT, HF_HOME and the hub's token are
//! honoured.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{IsTerminal, Read};
use std::path::{Path, PathBuf};

use clap::Args;
use diffusion::ModelSource;
use hf_hub::api::sync::{ApiBuilder, ApiError, ApiRepo};
use hf_hub::{Repo, RepoType};
use serde_json::json;
use sha1::Sha1;
use sha2::{Digest, Sha256};

use super::error::Error;
use crate::terminal::output::{print, print_json};

/// Options of `model pull`.
#[derive(Args)]
pub struct Pull {
    /// The model's name on the hub, such as stabilityai/stable-diffusion-x4-upscaler
    name: String,
    /// A branch, tag or commit
    #[arg(long, default_value = "main")]
    revision: String,
    /// Weights in this variant where there are some
    #[arg(long, value_parser = ["fp16", "bf16"])]
    variant: Option<String>,
}

impl Pull {
    /// Gets what is not there yet, checks all of it, and prints the model's folder.
    pub fn run(self, json: bool) -> Result<(), Error> {
        self.check_name()?;
        let progress = !json && std::io::stderr().is_terminal();
        let api = ApiBuilder::from_env()
            .with_progress(progress)
            .build()
            .map_err(|error| self.failure("", &error))?;
        let repo = api.repo(Repo::with_revision(
            self.name.clone(),
            RepoType::Model,
            self.revision.clone(),
        ));
        let info = repo.info().map_err(|error| self.failure("", &error))?;
        let there: BTreeSet<String> = info
            .siblings
            .into_iter()
            .map(|file| file.rfilename)
            .collect();
        let wanted = ModelSource::choose(&self.name, &there, self.variant.as_deref())?;
        let paths = wanted
            .iter()
            .map(|name| self.get(&repo, name))
            .collect::<Result<Vec<_>, _>>()?;
        let folder = paths
            .iter()
            .zip(&wanted)
            .find_map(|(path, name)| folder_of(path, name))
            .unwrap_or_default();
        if json {
            print_json(
                &json!({"model": self.name, "folder": folder, "commit": info.sha, "files": wanted}),
            );
        } else {
            print(&folder.display());
        }
        Ok(())
    }

    fn check_name(&self) -> Result<(), Error> {
        let plain = |part: &str| {
            !part.is_empty()
                && !part.starts_with('.')
                && part
                    .chars()
                    .all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c))
        };
        // The name becomes part of an address, in which `..` or `?` would lead elsewhere.
        if self.name.split('/').count() == 2 && self.name.split('/').all(plain) {
            return Ok(());
        }
        let help =
            "a name on the hub reads owner/model, such as stabilityai/stable-diffusion-x4-upscaler";
        Err(Error::usage(
            format!("`{}` is no name of a model", self.name),
            help,
        ))
    }

    /// The file, from the cache or the hub, as sound as its digest says.
    fn get(&self, repo: &ApiRepo, name: &str) -> Result<PathBuf, Error> {
        let path = repo.get(name).map_err(|error| self.failure(name, &error))?;
        let unreadable = |error| {
            Error::usage(
                format!("{}: {error}", path.display()),
                "check the cache's folder, HF_HOME",
            )
        };
        // In the hub's cache the file is a link, and what it leads to bears the digest as its name.
        let blob = path.canonicalize().map_err(unreadable)?;
        let expected = blob
            .file_name()
            .map(|name| name.to_string_lossy().into_owned())
            .unwrap_or_default();
        let actual = digest_like(&expected, &blob).map_err(unreadable)?;
        if actual.is_none_or(|actual| actual == expected) {
            return Ok(path);
        }
        // Both are removed, the file and the link to it, so that the next try gets it anew.
        std::fs::remove_file(&blob)
            .and_then(|()| std::fs::remove_file(&path))
            .map_err(unreadable)?;
        let problem = format!(
            "{}: {name} is not what its digest {expected} says; it was removed",
            self.name
        );
        Err(Error::usage(problem, "the same command gets it again"))
    }

    fn failure(&self, name: &str, error: &ApiError) -> Error {
        let what = if name.is_empty() {
            self.name.clone()
        } else {
            format!("{}: {name}", self.name)
        };
        let help = "check the name, the connection and HF_ENDPOINT; the same command goes on where it stopped";
        Error::usage(format!("{what} cannot be got from the hub: {error}"), help)
    }
}

/// What `path` leads to without the `name` at its end.
fn folder_of(path: &Path, name: &str) -> Option<PathBuf> {
    // A file's name can have folders in it, as `unet/config.json` has.
    path.ancestors()
        .nth(name.split('/').count())
        .map(Path::to_owned)
}

/// The file's digest of the kind that the hub's tag is: SHA-256 for large files, git's SHA-1 for
/// small ones. `None` for a tag that is neither.
fn digest_like(tag: &str, path: &Path) -> std::io::Result<Option<String>> {
    let mut file = File::open(path)?;
    if tag.is_empty() || !tag.chars().all(|c| c.is_ascii_hexdigit()) {
        return Ok(None);
    }
    match tag.len() {
        64 => digest(Sha256::new(), &mut file).map(Some),
        40 => {
            // git puts this head before the bytes when it names a file.
            let size = file.metadata()?.len();
            digest(Sha1::new_with_prefix(format!("blob {size}\0")), &mut file).map(Some)
        }
        _ => Ok(None),
    }
}

fn digest<D: Digest>(mut hasher: D, file: &mut impl Read) -> std::io::Result<String> {
    // In pieces: a file of weights can be larger than the memory.
    let mut buffer = vec![0; 1 << 20];
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(super::model_check::hex(&hasher.finalize())),
            count => hasher.update(&buffer[..count]),
        }
    }
}
