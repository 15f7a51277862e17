//! What a camera saw as one OpenEXR file: float channels R, G, B (A) (Z) (mask), scene-linear
//! Rec.709, and the camera in the standard attributes.
//!
//! The `exr` crate writes custom attributes in random order, so that there is one per list:
//! `srnerf`, whatever the writer tells, among the layer's attributes, and `colorInteropID` among
//! the image's. The camera in the file is a single-precision copy for viewers; `transforms.json`
//! holds the exact one. OpenEXR has no attribute for lens distortion.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use exr::block::reader::Reader;
use exr::meta::attribute::{AttributeValue, Chromaticities, SampleType, Text};
use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer,
    LayerAttributes, LineOrder, ReadChannels, ReadLayers, Vec2, WritableImage,
};
use glam::{DMat4, DVec4};

use crate::Camera;
use crate::file_bytes::LARGEST_COMPRESSION_RATIO;
use crate::pixels::{Linear, Pixels};

const REC_709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

/// The channel of masks: 1 where a pixel counts, 0 where not.
const MASK: &str = "mask";

/// What lies in a file beside the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Channels {
    /// Colours and coverage.
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

/// The file of what a camera saw. `about` is the text of the attribute `srnerf`.
///
/// # Errors
/// Texts and sizes that OpenEXR cannot hold.
pub fn to_bytes(
    camera: &Camera,
    pixels: &Pixels<Linear>,
    depth: Option<&[f32]>,
    mask: Option<&[bool]>,
    about: &str,
) -> Result<Vec<u8>, ExrError> {
    let mut image = Image::from_layer(Layer::new(
        (camera.width as usize, camera.height as usize),
        attributes(camera, about)?,
        Encoding {
            compression: Compression::ZIP16,
            blocks: Blocks::ScanLines,
            line_order: LineOrder::Increasing,
        },
        AnyChannels::sort(list(pixels, depth, mask).into()),
    ));
    image.attributes.chromaticities = Some(REC_709);
    let color_space = AttributeValue::Text(Text::new_or_panic("lin_rec709_scene"));
    image
        .attributes
        .other
        .insert(Text::new_or_panic("colorInteropID"), color_space);
    let mut bytes = Cursor::new(Vec::new());
    // The parallel writer may order the blocks by who comes first.
    let written = image.write().non_parallel().to_buffered(&mut bytes);
    written.map_err(ExrError::of)?;
    Ok(bytes.into_inner())
}

fn list(
    pixels: &Pixels<Linear>,
    depth: Option<&[f32]>,
    mask: Option<&[bool]>,
) -> Vec<AnyChannel<FlatSamples>> {
    let plane = |offset: usize| pixels.rgb.iter().skip(offset).step_by(3).copied().collect();
    let color = [("R", plane(0)), ("G", plane(1)), ("B", plane(2))].into_iter();
    let alpha = pixels.alpha.iter().map(|alpha| ("A", alpha.clone()));
    let depth = depth.iter().map(|depth| ("Z", depth.to_vec()));
    let mask = mask.iter().map(|mask| {
        let values = mask.iter().map(|counts| f32::from(u8::from(*counts)));
        (MASK, values.collect())
    });
    color
        .chain(alpha)
        .chain(depth)
        .chain(mask)
        .map(|(name, values)| AnyChannel::new(name, FlatSamples::F32(values)))
        .collect()
}

fn attributes(camera: &Camera, about: &str) -> Result<LayerAttributes, ExrError> {
    let unknown = || ExrError::new("provenance", "holds characters that OpenEXR cannot");
    let about = Text::new_or_none(about).ok_or_else(unknown)?;
    let world_to_camera = world_to_camera(camera);
    let width = f64::from(camera.width);
    let height = f64::from(camera.height);
    let off_center = [
        (width / 2.0 - camera.cx) / camera.fl_x,
        (camera.cy - height / 2.0) / camera.fl_y,
    ];
    let mut attributes = LayerAttributes {
        world_to_camera: Some(row_vector_matrix(world_to_camera)),
        world_to_normalized_device: Some(row_vector_matrix(
            camera_to_ndc(camera) * world_to_camera,
        )),
        near_clip_plane: Some(camera.near as f32),
        far_clip_plane: Some(camera.far as f32),
        screen_window_width: (width / camera.fl_x) as f32,
        screen_window_center: Vec2(off_center[0] as f32, off_center[1] as f32),
        ..LayerAttributes::default()
    };
    attributes
        .other
        .insert(Text::new_or_panic("srnerf"), AttributeValue::Text(about));
    Ok(attributes)
}

/// World to OpenEXR's camera space: left-handed, +x right, +y up, +z forward.
fn world_to_camera(camera: &Camera) -> DMat4 {
    let flip_z = DMat4::from_diagonal(DVec4::new(1.0, 1.0, -1.0, 1.0));
    flip_z * camera.camera_to_world.inverse()
}

/// OpenEXR's camera space to the image: (0, 0) upper left, (1, 1) lower right after division by w;
/// z, which readers discard, is 1/depth.
fn camera_to_ndc(camera: &Camera) -> DMat4 {
    let width = f64::from(camera.width);
    let height = f64::from(camera.height);
    DMat4::from_cols_array_2d(&[
        [camera.fl_x / width, 0.0, 0.0, 0.0],
        [0.0, -camera.fl_y / height, 0.0, 0.0],
        [camera.cx / width, camera.cy / height, 0.0, 1.0],
        [0.0, 0.0, 1.0, 0.0],
    ])
}

/// Imath multiplies row vectors from the left, so its rows are our columns.
fn row_vector_matrix(matrix: DMat4) -> [f32; 16] {
    matrix.to_cols_array().map(|value| value as f32)
}

/// Reads a file, whose picture must have this camera's size.
///
/// # Errors
/// Files that are not as [`to_bytes`] makes them.
pub fn read(bytes: &[u8], camera: &Camera) -> Result<Channels, ExrError> {
    let reader = Reader::read_from_buffered(Cursor::new(bytes), true).map_err(ExrError::of)?;
    check(reader.headers(), camera, bytes.len() as u64)?;
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
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
        mask: mask.map(|values| values.iter().map(|value| *value > 0.5).collect()),
    })
}

/// Refuses a header that does not describe what the camera saw, before anything is allocated for
/// its pixels.
fn check(headers: &[Header], camera: &Camera, file_length: u64) -> Result<(), ExrError> {
    let [header] = headers else {
        return Err(ExrError::new(
            "parts",
            format!("there are {}; expected 1", headers.len()),
        ));
    };
    if header.compression != Compression::ZIP16
        || header.blocks != BlockDescription::ScanLines
        || header.deep
    {
        return Err(ExrError::new(
            "encoding",
            format!(
                "is {}; expected flat scan lines, zip compression",
                header.compression
            ),
        ));
    }
    let channels = &header.channels.list;
    let names: Vec<String> = channels
        .iter()
        .map(|channel| channel.name.to_string())
        .collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let without_mask = match names.as_slice() {
        [names @ .., MASK] => names,
        names => names,
    };
    let (["B", "G", "R"] | ["A", "B", "G", "R"] | ["B", "G", "R", "Z"] | ["A", "B", "G", "R", "Z"]) =
        without_mask
    else {
        return Err(ExrError::new(
            "channels",
            format!(
                "are {}; expected B, G, R, perhaps A, Z and mask",
                names.join(", ")
            ),
        ));
    };
    if channels
        .iter()
        .any(|channel| channel.sample_type != SampleType::F32 || channel.sampling != Vec2(1, 1))
    {
        return Err(ExrError::new(
            "channels",
            "are not all 32-bit float without subsampling".to_owned(),
        ));
    }
    check_size(
        header,
        (camera.width as usize, camera.height as usize),
        file_length,
    )
}

fn check_size(header: &Header, expected: (usize, usize), file_length: u64) -> Result<(), ExrError> {
    let Vec2(width, height) = header.layer_size;
    if (width, height) != expected {
        let problem = format!(
            "is {width}x{height}; transforms.json says {}x{}",
            expected.0, expected.1
        );
        return Err(ExrError::new("data window", problem));
    }
    let pixels = width as u64 * height as u64;
    if pixels * 4 * header.channels.list.len() as u64 / LARGEST_COMPRESSION_RATIO > file_length {
        return Err(ExrError::new(
            "data window",
            format!("is {width}x{height}, which {file_length} bytes cannot hold"),
        ));
    }
    Ok(())
}
