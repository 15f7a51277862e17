//! Whether an OpenEXR file's header is that of a picture of ours. Reads no pixels.

use exr::meta::BlockDescription;
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;
use exr::prelude::{Compression, Vec2};

use super::{ExrError, MASK};
use crate::{Camera, LARGEST_COMPRESSION_RATIO};

/// Refuses a header that does not describe what the camera saw, before anything is allocated for
/// its pixels.
pub fn check(headers: &[Header], camera: &Camera, file_length: u64) -> Result<(), ExrError> {
    let [header] = headers else {
        return Err(ExrError::new(
            "parts",
            format!("there are {}; expected 1", headers.len()),
        ));
    };
    // Only what `to_bytes` writes: a damaged file then reaches less of the decoder.
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
    // Sorted by name, as the format has channels.
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
    // No deflate stream grows by more than this, so such a file must be damaged.
    if pixels * 4 * header.channels.list.len() as u64 / LARGEST_COMPRESSION_RATIO > file_length {
        return Err(ExrError::new(
            "data window",
            format!("is {width}x{height}, which {file_length} bytes cannot hold"),
        ));
    }
    Ok(())
}
