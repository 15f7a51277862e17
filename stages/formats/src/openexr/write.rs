//! The bytes of an OpenEXR file, the same for the same picture.

use std::io::Cursor;

use exr::meta::attribute::{AttributeValue, Chromaticities, Text};
use exr::meta::header::ImageAttributes;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer,
    LayerAttributes, LineOrder, Vec2, WritableImage,
};
use glam::{DMat4, DVec4};

use super::{ExrError, MASK};
use crate::{Camera, Linear, Pixels};

const REC_709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

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
            // Lossless: pixels must come back bit by bit.
            compression: Compression::ZIP16,
            blocks: Blocks::ScanLines,
            line_order: LineOrder::Increasing,
        },
        // The format demands channels in the order of their names.
        AnyChannels::sort(list(pixels, depth, mask).into()),
    ));
    image.attributes = image_attributes(image.attributes);
    let mut bytes = Cursor::new(Vec::new());
    // The parallel writer may order the blocks by who comes first.
    let written = image.write().non_parallel().to_buffered(&mut bytes);
    written.map_err(ExrError::of)?;
    Ok(bytes.into_inner())
}

/// What a picture's numbers are, told to whoever reads them.
pub fn image_attributes(mut attributes: ImageAttributes) -> ImageAttributes {
    attributes.chromaticities = Some(REC_709);
    let color_space = AttributeValue::Text(Text::new_or_panic("lin_rec709_scene"));
    attributes
        .other
        .insert(Text::new_or_panic("colorInteropID"), color_space);
    attributes
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

/// The camera, and what the writer tells.
pub fn attributes(camera: &Camera, about: &str) -> Result<LayerAttributes, ExrError> {
    let unknown = || ExrError::new("provenance", "holds characters that OpenEXR cannot");
    let about = Text::new_or_none(about).ok_or_else(unknown)?;
    let world_to_camera = world_to_camera(camera);
    let width = f64::from(camera.width);
    let height = f64::from(camera.height);
    // At depth 1; y is turned, since OpenEXR's screen window has y up.
    let off_center = [
        (width / 2.0 - camera.cx) / camera.fl_x,
        (camera.cy - height / 2.0) / camera.fl_y,
    ];
    // Single precision is all that these attributes hold; the exact camera is in `transforms.json`.
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
        // The last number makes w the depth, by which the others are divided.
        [camera.cx / width, camera.cy / height, 0.0, 1.0],
        [0.0, 0.0, 1.0, 0.0],
    ])
}

/// Imath multiplies row vectors from the left, so its rows are our columns.
fn row_vector_matrix(matrix: DMat4) -> [f32; 16] {
    matrix.to_cols_array().map(|value| value as f32)
}
