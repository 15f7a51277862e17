//! What a camera saw as one OpenEXR file: float channels R, G, B (A) (Z) (mask), scene-linear
//! Rec.709, and the camera in the standard attributes.
//!
//! The `exr` crate writes custom attributes in random order, so that there is one per list:
//! `srnerf`, whatever the writer tells, among the layer's attributes, and `colorInteropID` among
//! the image's. The camera in the file is a single-precision copy for viewers; `transforms.json`
//! holds the exact one. OpenEXR has no attribute for lens distortion.

mod check;
mod frame;
mod write;

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use exr::block::reader::Reader;
use exr::meta::MetaData;
use exr::prelude::{AnyChannel, FlatSamples, ReadChannels, ReadLayers};

use crate::{Camera, Linear, Pixels};

use check::check;
pub use frame::{Frame, FrameOptions, Packing};
pub use write::to_bytes;

/// The channel of masks: 1 where a pixel counts, 0 where not.
const MASK: &str = "mask";

/// What lies in a file beside the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Channels {
    /// Colours, scene-linear and premultiplied, and coverage.
    pub pixels: Pixels<Linear>,
    /// Height x width, depth along the viewing axis in scene units.
    pub depth: Option<Vec<f32>>,
    /// Height x width, which pixels count where some do not.
    pub mask: Option<Vec<bool>>,
}

/// Why a file cannot be read or written.
#[derive(Debug, PartialEq, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct ExrError {
    /// Where in the file: "channels".
    pub place: &'static str,
    /// What is there, and what was expected.
    pub problem: String,
}

impl ExrError {
    fn new(place: &'static str, problem: impl ToString) -> Self {
        Self {
            place,
            problem: problem.to_string(),
        }
    }

    fn of(error: exr::error::Error) -> Self {
        Self::new("OpenEXR", error)
    }
}

/// Reads a file, whose picture must have this camera's size.
///
/// # Errors
/// Files that are not as [`to_bytes`] makes them.
pub fn read(bytes: &[u8], camera: &Camera) -> Result<Channels, ExrError> {
    // `true`: pedantic, so that what the format does not allow is an error.
    let reader = Reader::read_from_buffered(Cursor::new(bytes), true).map_err(ExrError::of)?;
    // Before any pixel is read: a header may claim any size.
    check(reader.headers(), camera, bytes.len() as u64)?;
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        // Sets of images are read in parallel already, a file a thread.
        .non_parallel()
        .from_chunks(reader)
        .map_err(ExrError::of)?;
    channels(image.layer_data.channel_data.list.into_iter())
        .ok_or_else(|| ExrError::new("channels", "R, G and B are not all there"))
}

/// Whether the file at `path` has a channel of coverage, from its header alone.
///
/// # Errors
/// Files that cannot be read, or whose header is none.
pub fn has_alpha(path: &Path) -> Result<bool, ExrError> {
    let meta = MetaData::read_from_file(path, true).map_err(ExrError::of)?;
    let mut channels = meta.headers.iter().flat_map(|header| &header.channels.list);
    Ok(channels.any(|channel| channel.name == *"A"))
}

fn channels(list: impl Iterator<Item = AnyChannel<FlatSamples>>) -> Option<Channels> {
    let mut planes: BTreeMap<String, Vec<f32>> = list
        .filter_map(|channel| match channel.sample_data {
            FlatSamples::F32(values) => Some((channel.name.to_string(), values)),
            _ => None,
        })
        .collect();
    let red = planes.remove("R")?;
    let green = planes.remove("G")?;
    let blue = planes.remove("B")?;
    let colors = red.into_iter().zip(green).zip(blue);
    let rgb: Vec<[f32; 3]> = colors.map(|((r, g), b)| [r, g, b]).collect();
    let alpha = planes.remove("A");
    let mask = planes.remove(MASK);
    Some(Channels {
        pixels: Pixels::new(rgb.into_flattened(), alpha),
        depth: planes.remove("Z"),
        // Masks are 0 or 1 where we wrote them; half of that tells others' too.
        mask: mask.map(|values| values.iter().map(|value| *value > 0.5).collect()),
    })
}
