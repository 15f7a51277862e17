//! Writes photos and masks as 8-bit PNGs. Knows no layouts.

use std::path::Path;

use image::{GrayImage, Luma, Rgb, RgbImage, Rgba, RgbaImage};

use crate::{Photo, SceneError};

/// Writes a photo with four channels; one that has no alpha is opaque.
pub(crate) fn write_rgba(path: &Path, photo: &Photo) -> Result<(), SceneError> {
    let image = RgbaImage::from_fn(photo.camera.width, photo.camera.height, |x, y| {
        let i = pixel(photo, x, y);
        let [r, g, b] = color(photo, i);
        // Not multiplied: PNG's alpha is straight, by its specification.
        Rgba([r, g, b, byte(photo.pixels.coverage(i))])
    });
    let saved = image.save(path);
    saved.map_err(|error| SceneError::content(path, "the photo", error.to_string()))
}

/// Writes a photo with as many channels as it has.
pub(crate) fn write(path: &Path, photo: &Photo) -> Result<(), SceneError> {
    if photo.pixels.alpha.is_some() {
        return write_rgba(path, photo);
    }
    let image = RgbImage::from_fn(photo.camera.width, photo.camera.height, |x, y| {
        Rgb(color(photo, pixel(photo, x, y)))
    });
    let saved = image.save(path);
    saved.map_err(|error| SceneError::content(path, "the photo", error.to_string()))
}

/// Writes a mask of a photo, in white where `is_white` says so of whether a pixel counts.
pub(crate) fn write_mask(
    path: &Path,
    photo: &Photo,
    mask: Option<&[bool]>,
    is_white: fn(bool) -> bool,
) -> Result<(), SceneError> {
    let image = GrayImage::from_fn(photo.camera.width, photo.camera.height, |x, y| {
        let counts = mask.is_none_or(|mask| mask[pixel(photo, x, y)]);
        // Full white and full black, so that any threshold gives the mask back.
        Luma([255 * u8::from(is_white(counts))])
    });
    let saved = image.save(path);
    saved.map_err(|error| SceneError::content(path, "the mask", error.to_string()))
}

fn pixel(photo: &Photo, x: u32, y: u32) -> usize {
    y as usize * photo.camera.width as usize + x as usize
}

fn color(photo: &Photo, i: usize) -> [u8; 3] {
    [0, 1, 2].map(|channel| byte(photo.pixels.rgb[3 * i + channel]))
}

fn byte(value: f32) -> u8 {
    // Rounded to the nearest: cutting off would darken pictures by half a step.
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}
