//! The networks that an evaluation measures with, from files that the user names. Knows nothing of
//! how pictures come about.

use std::path::{Path, PathBuf};

use artifacts_schema::Digest;
use formats::FileBytes;
use metrics::{Image, Lpips};

use super::scores::Scored;
use crate::error::StageError;
use crate::stage::Source;

/// Networks, a column each.
pub struct Networks(Vec<Lpips>);

impl Networks {
    /// Those in these files.
    pub fn open(files: &[PathBuf]) -> Result<Self, StageError> {
        let open = |path: &PathBuf| Ok(Lpips::open(bytes(path)?)?);
        let networks: Vec<Lpips> = files.iter().map(open).collect::<Result<_, StageError>>()?;
        for (at, network) in networks.iter().enumerate() {
            // Columns go by the networks' names, so that the second would overwrite the first.
            if networks[..at]
                .iter()
                .any(|other| other.name() == network.name())
            {
                let problem = format!("has two files of {}; one column has one", network.name());
                return Err(StageError::parameter("lpips", problem));
            }
        }
        Ok(Self(networks))
    }

    /// How far an image is from the truth, by each.
    pub fn measure(&self, truth: Image, image: Image) -> Vec<Scored> {
        let scored = |network: &Lpips| {
            let distance = network.distance(truth, image);
            let least = || {
                let [width, height] = [image.width(), image.height()];
                format!("{width}x{height} pixels; a side needs 32")
            };
            (network.name(), distance.ok_or_else(least))
        };
        self.0.iter().map(scored).collect()
    }
}

/// What is in the files, for the key.
pub fn sources(files: &[PathBuf]) -> Result<Vec<Source>, StageError> {
    // An evaluation comes last: a file that holds no such network is refused before hours of
    // training.
    Networks::open(files)?;
    let source = |(at, path): (usize, &PathBuf)| {
        Ok(Source {
            name: format!("lpips.{at}"),
            digest: Digest::new(*blake3::hash(&bytes(path)?).as_bytes()),
        })
    };
    files.iter().enumerate().map(source).collect()
}

fn bytes(path: &Path) -> Result<FileBytes, StageError> {
    FileBytes::map(path).map_err(|error| StageError::parameter("lpips", error.to_string()))
}
