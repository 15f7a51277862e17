//! Reads PNG and JPEG photos within limits. Knows nothing of cameras.

use std::path::{Path, PathBuf};

use image::{DynamicImage, ImageReader, Limits};

use crate::SceneError;

/// Larger than any camera's sensor; a header that asks for more is not believed.
const LARGEST_SIDE: u32 = 1 << 15;
const EXTENSIONS: [&str; 4] = ["png", "jpg", "jpeg", "JPG"];
const LARGEST_ALLOCATION: u64 = 512 << 20;

/// Pixels of one photo, sRGB-encoded in 0..=1.
pub(crate) struct Pixels {
    pub(crate) size: (u32, u32),
    /// `height * width * 3`.
    pub(crate) rgb: Vec<f32>,
    /// `height * width`, where the file has it.
    pub(crate) alpha: Option<Vec<f32>>,
}

/// The PNG and JPEG files of a folder, sorted by name (bytewise, so the same everywhere).
pub(crate) fn list(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let io = |source| SceneError::Io {
        path: folder.into(),
        source,
    };
    let entries: Result<Vec<_>, _> = std::fs::read_dir(folder).map_err(io)?.collect();
    let mut files: Vec<PathBuf> = entries
        .map_err(io)?
        .iter()
        .map(|e| e.path())
        .filter(|p| is_image(p))
        .collect();
    files.sort();
    Ok(files)
}

fn is_image(path: &Path) -> bool {
    let hidden = path
        .file_name()
        .is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    !hidden
        && path
            .extension()
            .and_then(|e| e.to_str())
            .is_some_and(is_extension)
        && path.is_file()
}

/// Whether this is how names of photos end.
pub(crate) fn is_extension(extension: &str) -> bool {
    EXTENSIONS
        .iter()
        .any(|known| extension.eq_ignore_ascii_case(known))
}

/// The file that is meant by a path which may lack its extension, or have that of another copy of the photo.
pub(crate) fn find(path: &Path) -> Option<PathBuf> {
    let named = path
        .extension()
        .and_then(|e| e.to_str())
        .is_some_and(is_extension);
    let with = |extension: &&str| match named {
        true => path.with_extension(extension),
        false => PathBuf::from(format!("{}.{extension}", path.display())),
    };
    let is_photo = |path: &PathBuf| is_image(path);
    Some(path.to_owned())
        .filter(is_photo)
        .or_else(|| EXTENSIONS.iter().map(with).find(is_photo))
}

/// Width and height from the file's header alone.
pub(crate) fn size(path: &Path) -> Result<(u32, u32), SceneError> {
    open(path)?
        .into_dimensions()
        .map_err(|error| unreadable(path, error))
        .and_then(|size| non_empty(path, size))
}

/// Decodes a photo. EXIF orientation is left alone, as pose estimation leaves it.
pub(crate) fn read(path: &Path) -> Result<Pixels, SceneError> {
    let decoded = open(path)?
        .decode()
        .map_err(|error| unreadable(path, error))?;
    let size = non_empty(path, (decoded.width(), decoded.height()))?;
    let (rgb, alpha) = channels(decoded);
    Ok(Pixels { size, rgb, alpha })
}

fn open(path: &Path) -> Result<ImageReader<std::io::BufReader<std::fs::File>>, SceneError> {
    let io = |source| SceneError::Io {
        path: path.into(),
        source,
    };
    let mut reader = ImageReader::open(path)
        .map_err(io)?
        .with_guessed_format()
        .map_err(io)?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(LARGEST_SIDE);
    limits.max_image_height = Some(LARGEST_SIDE);
    limits.max_alloc = Some(LARGEST_ALLOCATION);
    reader.limits(limits);
    Ok(reader)
}

fn channels(image: DynamicImage) -> (Vec<f32>, Option<Vec<f32>>) {
    if !image.color().has_alpha() {
        return (image.into_rgb32f().into_raw(), None);
    }
    let rgba = image.into_rgba32f();
    let rgb = rgba
        .pixels()
        .flat_map(|pixel| [pixel[0], pixel[1], pixel[2]])
        .collect();
    // Many tools write an alpha channel of ones: such a photo is opaque.
    let alpha: Vec<f32> = rgba.pixels().map(|pixel| pixel[3]).collect();
    (
        rgb,
        Some(alpha).filter(|alpha| alpha.iter().any(|value| *value < 1.0)),
    )
}

fn non_empty(path: &Path, size: (u32, u32)) -> Result<(u32, u32), SceneError> {
    match size {
        (0, _) | (_, 0) => Err(SceneError::Image {
            path: path.into(),
            fault: "it has no pixels".into(),
        }),
        _ => Ok(size),
    }
}

fn unreadable(path: &Path, error: image::ImageError) -> SceneError {
    SceneError::Image {
        path: path.into(),
        fault: error.to_string(),
    }
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
        let pixels = read(&path).unwrap();
        assert_eq!(pixels.size, (2, 2));
        assert_eq!(pixels.rgb[3..9], [0.2, 0.0, 1.0, 0.0, 0.4, 1.0]);
        assert_eq!(pixels.alpha, None);
    }

    #[test]
    fn alpha_is_kept_apart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        image::RgbaImage::from_pixel(1, 2, Rgba([255, 0, 0, 51]))
            .save(&path)
            .unwrap();
        let pixels = read(&path).unwrap();
        assert_eq!(pixels.rgb, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(pixels.alpha, Some(vec![0.2, 0.2]));
    }

    #[test]
    fn a_jpeg_is_read_whatever_its_extension_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let grey = image::RgbImage::from_pixel(9, 7, Rgb([128, 128, 128]));
        grey.save_with_format(&path, image::ImageFormat::Jpeg)
            .unwrap();
        let pixels = read(&path).unwrap();
        assert_eq!((pixels.size, pixels.rgb.len()), ((9, 7), 9 * 7 * 3));
        assert!(pixels.rgb.iter().all(|value| (value - 0.502).abs() < 0.01));
    }

    #[test]
    fn only_visible_images_are_listed_and_in_order() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "b.PNG",
            "a.jpg",
            "notes.txt",
            ".c.png",
            "a10.jpeg",
            "a2.jpeg",
        ] {
            std::fs::write(folder.path().join(name), b"").unwrap();
        }
        let files = list(folder.path()).unwrap();
        let names: Vec<_> = files
            .iter()
            .map(|f| f.file_name().unwrap().to_str().unwrap())
            .collect();
        assert_eq!(names, ["a.jpg", "a10.jpeg", "a2.jpeg", "b.PNG"]);
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
            let message = read(&path).err().unwrap().to_string();
            assert!(
                message.contains("photo.png: not a readable PNG or JPEG image"),
                "{message}"
            );
            assert!(size(&path).is_err());
        }
        std::fs::write(&path, png_claiming(1, 1)).unwrap();
        assert!(read(&path).is_ok(), "the forged header itself is sound");
    }
}
