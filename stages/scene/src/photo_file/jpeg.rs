//! JPEG without mercy: what other decoders warn of and fill with grey is an error here. Knows
//! nothing of scenes.

use image::{DynamicImage, GrayImage, RgbImage};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// Decodes a JPEG file of at most `largest` pixels a side. The error says what is damaged.
pub(super) fn decode(bytes: &[u8], largest: u32) -> Result<DynamicImage, String> {
    // Cut short, a file would be filled up with grey.
    if !is_whole(bytes) {
        return Err("it ends before its last row: it was cut short".into());
    }
    let options = DecoderOptions::default()
        // A damaged scan is an error; else it would be filled up and taken for a photo.
        .set_strict_mode(true)
        .set_max_width(largest as usize)
        .set_max_height(largest as usize);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder
        .decode_headers()
        .map_err(|fault| fault.to_string())?;
    // Asked for as stored: grey photos take a third of the memory, and stay exactly grey.
    let grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let wanted = if grey {
        ColorSpace::Luma
    } else {
        ColorSpace::RGB
    };
    decoder.set_options(options.jpeg_set_out_colorspace(wanted));
    let pixels = decoder.decode().map_err(|fault| fault.to_string())?;
    let (width, height) = decoder.dimensions().ok_or("it has no size")?;
    let size = (width as u32, height as u32);
    let image = if grey {
        GrayImage::from_raw(size.0, size.1, pixels).map(DynamicImage::ImageLuma8)
    } else {
        RgbImage::from_raw(size.0, size.1, pixels).map(DynamicImage::ImageRgb8)
    };
    image.ok_or_else(|| "it holds fewer pixels than it says".into())
}

/// Whether the file goes on to its end-of-image marker. What follows that, such as a phone's film,
/// is not looked at.
fn is_whole(bytes: &[u8]) -> bool {
    const END_OF_IMAGE: u8 = 0xD9;
    // Behind the two bytes of the start marker, which `Format::of` has seen.
    let mut at = 2;
    while let Some(&[first, marker]) = bytes.get(at..at + 2) {
        match (first, marker) {
            (0xFF, END_OF_IMAGE) => return true,
            // Fill bytes before a marker.
            (0xFF, 0xFF) => at += 1,
            // Restarts and stuffed bytes have no length, and belong to a scan.
            (0xFF, 0x00 | 0x01 | 0xD0..=0xD8) => at += 2,
            (0xFF, _) => {
                let Some(&[high, low]) = bytes.get(at + 2..at + 4) else {
                    return false;
                };
                // A length counts its own two bytes; less than that would stand still.
                at += 2 + usize::from(u16::from_be_bytes([high, low])).max(2);
            }
            // A scan's own bytes.
            _ => at += 1,
        }
    }
    false
}
