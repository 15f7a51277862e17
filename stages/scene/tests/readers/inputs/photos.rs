//! The photos themselves: masks, orientation, damage and formats.

use super::{SIZE, capture, for_frames, holds, photo, read, refusal, save, transforms};
use image::{ImageFormat, Luma, Rgb, Rgb32FImage, RgbImage};
use serde_json::json;
use std::path::Path;
use tempfile::TempDir;

#[test]
fn masks_beside_photos_and_in_mask_path_leave_pixels_out() {
    // The left half is white.
    let half = |white: bool| {
        image::GrayImage::from_fn(SIZE.0, SIZE.1, |x, _| {
            Luma([255 * u8::from((x < 8) == white)])
        })
    };
    let masked = |folder: &TempDir| {
        let scene = transforms(folder).unwrap();
        assert_eq!(scene.photos.len(), 9, "masks are no photos");
        holds(
            &scene.notes.join("\n"),
            &["9 of 9 photos are masked (50.0 %"],
        );
        let mask = scene.photos[4].mask.clone().unwrap();
        (mask[0], mask[15])
    };
    let dynamic = capture(|_| {});
    for i in 0..9 {
        let path = dynamic
            .path()
            .join(format!("images/dynamic_mask_{i:04}.png"));
        save(half(true), &path, ImageFormat::Png);
    }
    assert_eq!(masked(&dynamic), (false, true), "instant-ngp: white is out");
    let named = capture(|page| for_frames(page, |_, frame| frame["mask_path"] = json!("m.png")));
    save(half(true), &named.path().join("m.png"), ImageFormat::Png);
    assert_eq!(masked(&named), (true, false), "nerfstudio: black is out");
    let of_colmap = capture(|_| {});
    for i in 0..9 {
        let path = of_colmap.path().join(format!("masks/{i:04}.png.png"));
        save(half(false), &path, ImageFormat::Png);
    }
    assert_eq!(masked(&of_colmap), (false, true), "COLMAP: black is out");
}

/// A JPEG with an EXIF orientation.
fn with_orientation(image: &RgbImage, orientation: u8) -> Vec<u8> {
    let mut jpeg = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 100);
    encoder.encode_image(image).unwrap();
    let tiff = [
        &b"Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0"[..],
        &[orientation, 0, 0, 0, 0, 0, 0],
    ]
    .concat();
    let length = (tiff.len() as u16 + 2).to_be_bytes();
    let segment = [&[0xFF, 0xE1][..], &length, &tiff].concat();
    [&jpeg[..2], &segment, &jpeg[2..]].concat()
}

#[test]
fn exif_orientation_turns_photos_where_their_cameras_are_for_that() {
    let turned = |w: u32, h: u32| {
        let folder = capture(|page| {
            page["w"] = json!(w);
            page["h"] = json!(h);
        });
        for i in 0..9 {
            let path = folder.path().join(format!("images/{i:04}.png"));
            std::fs::write(path, with_orientation(&photo(i), 6)).unwrap();
        }
        let scene = transforms(&folder).unwrap();
        let first = &scene.photos[0];
        (
            first.camera.width,
            first.pixels.rgb[0],
            scene.notes.join("\n"),
        )
    };
    let (width, red, notes) = turned(12, 16);
    holds(
        &notes,
        &["9 photos have the EXIF orientation 6 and are turned"],
    );
    // Red grows to the right; turned clockwise it grows downwards, from the same corner's row.
    assert_eq!(width, 12);
    assert!(red < 0.2, "{red}");
    let (width, _, notes) = turned(16, 12);
    assert_eq!(width, 16);
    holds(&notes, &["EXIF orientation 6, which is not applied"]);
}

#[test]
fn a_jpeg_that_was_cut_short_is_refused_by_name() {
    let folder = capture(|_| {});
    let path = folder.path().join("images/0003.png");
    let noise = |x: u32, y: u32| (x * 37 + y * 91 + x * y * 13) as u8;
    let busy = RgbImage::from_fn(64, 48, |x, y| {
        Rgb([noise(x, y), noise(y, x), noise(x + 7, y)])
    });
    let jpeg = with_orientation(&busy, 1);
    std::fs::write(&path, &jpeg).unwrap();
    assert_eq!(read(&folder).0, 9, "the whole one is read");
    std::fs::write(&path, &jpeg[..jpeg.len() / 2]).unwrap();
    holds(
        &refusal(&folder),
        &[
            "SCENE/images/0003.png: not a readable photo",
            "it was cut short",
            "copy it again",
        ],
    );
}

#[test]
fn exr_tiff_webp_and_deep_pngs_are_read() {
    let linear = Rgb32FImage::from_fn(SIZE.0, SIZE.1, |x, _| {
        Rgb([0.214_041_14, x as f32 / 8.0, 0.0])
    });
    let deep = image::ImageBuffer::from_fn(SIZE.0, SIZE.1, |_, _| Rgb([32_900u16, 257, 65_535]));
    let with = |name: &str, save: &dyn Fn(&Path)| {
        let folder = capture(|_| {});
        std::fs::remove_file(folder.path().join("images/0004.png")).unwrap();
        save(&folder.path().join(format!("images/{name}")));
        let scene = transforms(&folder).unwrap();
        assert_eq!(scene.photos.len(), 9, "{name}");
        (
            scene.photos[4].pixels.rgb[..3].to_vec(),
            scene.notes.join("\n"),
        )
    };
    let near = |values: &[f32], wanted: [f32; 3]| {
        values
            .iter()
            .zip(wanted)
            .for_each(|(a, b)| assert!((a - b).abs() < 1e-4, "{values:?}"));
    };
    let (exr, notes) = with("0004.exr", &|path| {
        save(linear.clone(), path, ImageFormat::OpenExr)
    });
    near(&exr, [0.5, 0.0, 0.0]);
    holds(&notes, &["1 photos hold linear values above 1"]);
    let deep_values = [32_900.0 / 65_535.0, 257.0 / 65_535.0, 1.0];
    for (name, format) in [
        ("0004.tif", ImageFormat::Tiff),
        ("0004.png", ImageFormat::Png),
    ] {
        let (values, _) = with(name, &|path| save(deep.clone(), path, format));
        near(&values, deep_values);
        assert_ne!(values[0], 128.0 / 255.0, "all sixteen bits count");
    }
    let (webp, _) = with("0004.webp", &|path| save(photo(4), path, ImageFormat::WebP));
    near(&webp, [0.0, 0.0, 4.0 / 255.0]);
}
