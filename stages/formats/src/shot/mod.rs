//! Cameras for the programs of film and games: as OpenUSD's text and as glTF. Knows no pictures.
//!
//! A shot is one camera that moves, a frame for each view, or as many cameras as there are views.
//! Both formats know pinholes alone; what of a camera they cannot hold is told.

pub mod glb;
mod gltf;
mod rate;
mod usd;

pub use rate::{Rate, RateError};

use crate::Camera;

/// Which way is up in the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Up {
    /// +y is up.
    Y,
    /// +z is up.
    Z,
}

/// A format of cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// OpenUSD as text.
    Usda,
    /// glTF 2.0 as JSON, its numbers within it.
    Gltf,
    /// glTF 2.0 in one binary file.
    Glb,
}

impl Format {
    /// The format that an ending of a file's name means.
    pub fn by_ending(ending: &str) -> Option<Self> {
        match ending.to_ascii_lowercase().as_str() {
            "usda" => Some(Self::Usda),
            "gltf" => Some(Self::Gltf),
            "glb" => Some(Self::Glb),
            _ => None,
        }
    }
}

/// Cameras, one after the other or side by side.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Names and cameras, at least one.
    pub cameras: Vec<(String, Camera)>,
    /// One camera that moves from frame to frame; else one for each view.
    pub moves: bool,
    /// How many frames a second the animation has.
    pub rate: Rate,
    /// The number of the first frame.
    pub first: u32,
    /// Which way is up.
    pub up: Up,
}

impl Shot {
    /// The bytes of the whole file. Equal shots give equal bytes.
    pub fn to_bytes(&self, format: Format) -> Vec<u8> {
        match format {
            Format::Usda => usd::text(self).into_bytes(),
            Format::Gltf => gltf::text(self).into_bytes(),
            Format::Glb => gltf::binary(self),
        }
    }

    /// What the file does not hold, a sentence each.
    pub fn left_out(&self, format: Format) -> Vec<String> {
        let mut notes = Vec::new();
        let count = |is: &dyn Fn(&Camera) -> bool| {
            let those = self.cameras.iter().filter(|(_, camera)| is(camera));
            those.count()
        };
        let bent = count(&|camera| !camera.distortion.is_none());
        if bent > 0 {
            notes.push(format!(
                "{bent} of {} cameras have a lens that bends, which no camera of this format does: pictures must be undistorted",
                self.cameras.len()
            ));
        }
        // USD shifts apertures and lets every attribute change over time: it holds what follows.
        if format == Format::Usda {
            return notes;
        }
        let off = self.cameras.iter().map(|(_, camera)| off_center(camera));
        let off = off.fold(0.0, f64::max);
        if off > 0.0 {
            notes.push(format!(
                "glTF's cameras look through the middle of the picture, and these up to {off:.2} pixels beside it; .usda holds that"
            ));
        }
        if self.moves && !self.has_one_lens() {
            notes.push(
                "a camera of glTF does not zoom: it has the lens of the first frame; .usda holds all"
                    .to_owned(),
            );
        }
        notes
    }

    fn has_one_lens(&self) -> bool {
        // Without the principal point, which glTF's cameras lack anyway.
        let lens = |camera: &Camera| [camera.fl_x, camera.fl_y, camera.near, camera.far];
        let size = |camera: &Camera| [camera.width, camera.height];
        let mut cameras = self.cameras.iter().map(|(_, camera)| camera);
        let first = cameras.next();
        first.is_none_or(|first| {
            cameras.all(|camera| lens(camera) == lens(first) && size(camera) == size(first))
        })
    }
}

/// How many pixels the optical axis lies from the middle, the larger of both ways.
fn off_center(camera: &Camera) -> f64 {
    let x = camera.cx - f64::from(camera.width) / 2.0;
    let y = camera.cy - f64::from(camera.height) / 2.0;
    x.abs().max(y.abs())
}

#[cfg(test)]
mod tests;
