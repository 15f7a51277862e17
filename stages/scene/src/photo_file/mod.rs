//! Reads one photo within limits: PNG, JPEG, WebP, TIFF and EXR, at full depth. Knows nothing of
//! cameras.

mod format;
mod jpeg;

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use formats::color::linear_to_srgb;
use formats::{Pixels, Srgb};
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageReader, Limits};

use crate::{SceneError, source_files};

pub(crate) use format::{FORMATS, Format, is_lfs_pointer, not_read, rank, split};

/// Larger than any camera's sensor; a header that asks for more is not believed.
const LARGEST_SIDE: u32 = 1 << 15;
/// No photo takes more memory than this, and a small file not even that: see
/// [`largest_allocation`].
const LARGEST_ALLOCATION: u64 = 512 << 20;
/// What any file may ask for, however few bytes it has: a photo of one colour is small.
const FREE_ALLOCATION: u64 = 64 << 20;
/// Beyond that a byte of the file gives at most so many bytes of pixels: more than deflate's 1032
/// of one.
const LARGEST_RATIO: u64 = 2048;

/// What is in the file of one photo.
pub(crate) struct Decoded {
    pub(crate) size: (u32, u32),
    /// Its pixels, 0 to 1; with alpha where the file has it.
    pub(crate) pixels: Pixels<Srgb>,
    /// Whether linear values above 1 were cut off.
    pub(crate) clipped: bool,
}

/// What a photo's header says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    /// Width and height as the file's rows lie, before any turn.
    pub(crate) size: (u32, u32),
    /// How the EXIF orientation tag says it is to be turned for people.
    pub(crate) orientation: Orientation,
}

impl Header {
    /// Width and height once it is turned as its tag says.
    pub(crate) fn turned_size(&self) -> (u32, u32) {
        match self.orientation.to_exif() {
            5..=8 => (self.size.1, self.size.0),
            _ => self.size,
        }
    }
}

/// Reads the header alone.
pub(crate) fn header(path: &Path) -> Result<Header, SceneError> {
    // By the first bytes, since the decoder's own message names no remedy.
    check_format(path)?;
    let mut decoder = open(path)?
        .into_decoder()
        .map_err(|error| unreadable(path, error))?;
    let size = non_empty(path, decoder.dimensions())?;
    // Refused before anything is computed, and not hours later when the photo is decoded.
    if size.0.max(size.1) > LARGEST_SIDE {
        let fault = format!(
            "it says {}x{} pixels, more than any camera has",
            size.0, size.1
        );
        return Err(SceneError::image(path, fault));
    }
    // A tag that cannot be read turns nothing.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    Ok(Header { size, orientation })
}

/// Width and height as the file's rows lie, from its header alone.
pub(crate) fn size(path: &Path) -> Result<(u32, u32), SceneError> {
    Ok(header(path)?.size)
}

/// Decodes a photo and turns it. A damaged or shortened file is an error, never a photo that is
/// grey in part.
pub(crate) fn read(path: &Path, turn: Orientation) -> Result<Decoded, SceneError> {
    let format = check_format(path)?;
    let mut decoded = if format == Format::Jpeg {
        // By a stricter decoder than the others: image's own fills a cut JPEG with grey.
        let bytes = source_files::read_bytes(path)?;
        jpeg::decode(&bytes, LARGEST_SIDE).map_err(|fault| SceneError::image(path, fault))?
    } else {
        open(path)?
            .decode()
            .map_err(|error| unreadable(path, error))?
    };
    decoded.apply_orientation(turn);
    let size = non_empty(path, (decoded.width(), decoded.height()))?;
    let (pixels, clipped) = channels(decoded, format);
    // One NaN would spread through the filters, and through training over the whole field.
    if pixels.rgb.iter().any(|value| !value.is_finite()) {
        return Err(SceneError::image(path, "a pixel is not a number"));
    }
    Ok(Decoded {
        size,
        pixels,
        clipped,
    })
}

/// Values from 0 to 1 of a mask: its alpha if that is all it has, else its brightness.
pub(crate) fn read_grey(
    path: &Path,
    turn: Orientation,
) -> Result<((u32, u32), Vec<f32>), SceneError> {
    let Decoded { size, pixels, .. } = read(path, turn)?;
    let Pixels { rgb, alpha, .. } = pixels;
    // Masks are black and white, or a colour on black.
    let brightest = |pixel: &[f32]| pixel.iter().copied().fold(0.0, f32::max);
    let grey: Vec<f32> = rgb.chunks_exact(3).map(brightest).collect();
    // A mask may lie in the alpha of a picture of one colour.
    let flat = grey.iter().all(|value| *value == grey[0]);
    Ok((size, alpha.filter(|_| flat).unwrap_or(grey)))
}

/// The file's format, by its first bytes, if it is one that is read.
fn check_format(path: &Path) -> Result<Format, SceneError> {
    let mut head = Vec::new();
    File::open(path)
        .and_then(|file| file.take(64).read_to_end(&mut head))
        .map_err(|source| SceneError::io(path, source))?;
    let fault = match Format::of(&head) {
        Format::NotRead(name) => format!("it is {name}, which is not read"),
        Format::LfsPointer => {
            return Err(SceneError::not_fetched(path));
        }
        Format::Empty => "the file is empty".into(),
        Format::Unknown => "it begins as no known image format does".into(),
        known => return Ok(known),
    };
    Err(SceneError::image(path, fault))
}

fn open(path: &Path) -> Result<ImageReader<BufReader<File>>, SceneError> {
    let io = |source| SceneError::io(path, source);
    let file = File::open(path).map_err(io)?;
    let bytes = file.metadata().map_err(io)?.len();
    // Content decides and not the ending: people rename files.
    let mut reader = ImageReader::new(BufReader::new(file))
        .with_guessed_format()
        .map_err(io)?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(LARGEST_SIDE);
    limits.max_image_height = Some(LARGEST_SIDE);
    limits.max_alloc = Some(largest_allocation(bytes));
    reader.limits(limits);
    Ok(reader)
}

/// How much memory the pixels of a file of so many bytes may take.
fn largest_allocation(bytes: u64) -> u64 {
    bytes
        // By the file's own size: a small file that claims a huge image is refused before memory
        // is.
        .saturating_mul(LARGEST_RATIO)
        .clamp(FREE_ALLOCATION, LARGEST_ALLOCATION)
}

/// Colours with coverage, and whether colours were cut off.
fn channels(image: DynamicImage, format: Format) -> (Pixels<Srgb>, bool) {
    // Whole numbers are sRGB-encoded; floating point is linear light.
    let linear = matches!(
        image,
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)
    );
    let (mut rgb, alpha) = colors_and_alpha(image);
    if !linear {
        return (Pixels::new(rgb, alpha), false);
    }
    // EXR's colours are multiplied by alpha.
    if let Some(alpha) = alpha.as_ref().filter(|_| format == Format::Exr) {
        // Everything behind the readers takes colours that are not multiplied.
        for (i, value) in rgb.iter_mut().enumerate() {
            *value = if alpha[i / 3] > 0.0 {
                *value / alpha[i / 3]
            } else {
                0.0
            };
        }
    }
    let clipped = rgb.iter().any(|value| *value > 1.0);
    // What is not a number stays so, and is refused.
    rgb.iter_mut()
        .for_each(|value| *value = linear_to_srgb(value.clamp(0.0, 1.0)));
    (Pixels::new(rgb, alpha), clipped)
}

/// Colours, interleaved, and alpha where any pixel is not opaque.
fn colors_and_alpha(image: DynamicImage) -> (Vec<f32>, Option<Vec<f32>>) {
    // Without a detour by four channels: photos of cameras are large.
    if !image.color().has_alpha() {
        return (image.into_rgb32f().into_raw(), None);
    }
    let rgba = image.into_rgba32f();
    let alpha: Vec<f32> = rgba
        .pixels()
        .map(|pixel| pixel[3].clamp(0.0, 1.0))
        .collect();
    let rgb = rgba
        .pixels()
        .flat_map(|pixel| [pixel[0], pixel[1], pixel[2]])
        .collect();
    // Many tools write an alpha channel of ones: such a photo is opaque.
    (
        rgb,
        Some(alpha).filter(|alpha| alpha.iter().any(|value| *value < 1.0)),
    )
}

fn non_empty(path: &Path, size: (u32, u32)) -> Result<(u32, u32), SceneError> {
    match size {
        (0, _) | (_, 0) => Err(SceneError::image(path, "it has no pixels")),
        _ => Ok(size),
    }
}

fn unreadable(path: &Path, error: image::ImageError) -> SceneError {
    let fault = match &error {
        image::ImageError::Limits(_) => {
            "it says more pixels than its bytes can hold, or than any camera has".into()
        }
        image::ImageError::IoError(source)
            if source.kind() == std::io::ErrorKind::UnexpectedEof =>
        {
            "it ends before its last row: it was cut short".into()
        }
        other => other.to_string(),
    };
    SceneError::image(path, fault)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, Rgba};

    #[test]
    fn eight_bit_values_come_out_as_255ths_row_by_row() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        image::RgbImage::from_fn(2, 2, |x, y| Rgb([x as u8 * 51, y as u8 * 102, 255]))
            .save(&path)
            .unwrap();
        let photo = read(&path, Orientation::NoTransforms).unwrap();
        assert_eq!(photo.size, (2, 2));
        assert_eq!(photo.pixels.rgb[3..9], [0.2, 0.0, 1.0, 0.0, 0.4, 1.0]);
        assert_eq!(photo.pixels.alpha, None);
    }

    #[test]
    fn alpha_is_kept_apart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        image::RgbaImage::from_pixel(1, 2, Rgba([255, 0, 0, 51]))
            .save(&path)
            .unwrap();
        let photo = read(&path, Orientation::NoTransforms).unwrap();
        assert_eq!(photo.pixels.rgb, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(photo.pixels.alpha, Some(vec![0.2, 0.2]));
    }

    #[test]
    fn a_jpeg_is_read_whatever_its_extension_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let grey = image::RgbImage::from_pixel(9, 7, Rgb([128, 128, 128]));
        grey.save_with_format(&path, image::ImageFormat::Jpeg)
            .unwrap();
        let photo = read(&path, Orientation::NoTransforms).unwrap();
        assert_eq!((photo.size, photo.pixels.rgb.len()), ((9, 7), 9 * 7 * 3));
        assert!(
            photo
                .pixels
                .rgb
                .iter()
                .all(|value| (value - 0.502).abs() < 0.01)
        );
    }

    /// A PNG whose header claims a size; the checksum is right, so only the size is wrong.
    fn png_claiming(width: u32, height: u32) -> Vec<u8> {
        let mut png = Vec::new();
        image::DynamicImage::new_rgb8(1, 1)
            .write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png)
            .unwrap();
        png[16..20].copy_from_slice(&width.to_be_bytes());
        png[20..24].copy_from_slice(&height.to_be_bytes());
        let checksum = crc32(&png[12..29]).to_be_bytes();
        png[29..33].copy_from_slice(&checksum);
        png
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |c, _| {
                if c & 1 == 1 {
                    c >> 1 ^ 0xEDB8_8320
                } else {
                    c >> 1
                }
            })
        })
    }

    #[test]
    fn empty_huge_and_broken_images_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photo.png");
        for bytes in [
            png_claiming(0, 5),
            png_claiming(60_000, 60_000),
            b"not a png".to_vec(),
            Vec::new(),
        ] {
            std::fs::write(&path, bytes).unwrap();
            let message = read(&path, Orientation::NoTransforms)
                .err()
                .unwrap()
                .to_string();
            assert!(
                message.contains("photo.png: not a readable photo"),
                "{message}"
            );
            assert!(size(&path).is_err());
        }
        std::fs::write(&path, png_claiming(1, 1)).unwrap();
        assert!(
            read(&path, Orientation::NoTransforms).is_ok(),
            "the forged header itself is sound"
        );
    }
}
