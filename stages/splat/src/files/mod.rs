//! Files of splats as other programs read them. Knows no rasteriser.

mod gltf;
mod ply;
mod usd;

use std::io::{self, Write};

pub use formats::shot::Up;

use crate::cloud::Cloud;

/// A file format that holds splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// The PLY of 3D Gaussian Splatting (Kerbl et al. 2023), which viewers and editors read.
    Ply,
    /// A binary glTF with `KHR_gaussian_splatting`.
    Glb,
    /// OpenUSD's text with a `ParticleField3DGaussianSplat`.
    Usda,
}

impl Format {
    /// The format that an ending of a file's name means.
    pub fn by_ending(ending: &str) -> Option<Self> {
        match ending.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            "glb" => Some(Self::Glb),
            "usda" => Some(Self::Usda),
            _ => None,
        }
    }

    /// Writes a cloud.
    ///
    /// # Errors
    /// If `out` takes no more, or the cloud is larger than the format's numbers.
    pub fn write(self, cloud: &Cloud, up: Up, out: &mut dyn Write) -> io::Result<()> {
        match self {
            Self::Ply => ply::write(cloud, out),
            Self::Glb => gltf::write(cloud, up, out),
            Self::Usda => usd::write(cloud, up, out),
        }
    }
}
