//! From what was rendered to a file for the browser. Knows nothing of fields.

use artifacts_schema::View;
use formats::Camera;
use glam::DVec3;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError};
use nerf::Rendered;
use stages::{colormap, convert};

use super::look::Show;

/// Of JPEG, from 1 to 100.
const QUALITY: u8 = 85;
/// Where less light is held back there is nothing that could face anywhere.
const SOLID: f32 = 0.5;

/// How a picture is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// Small and soon done: for cameras on their way.
    Jpeg,
    /// To the last bit of its 8.
    Png,
}

impl ImageFormat {
    /// As HTTP names it.
    pub fn mime(self) -> &'static str {
        match self {
            Self::Jpeg => "image/jpeg",
            Self::Png => "image/png",
        }
    }
}

/// 8-bit sRGB colours of a picture: height x width x 3.
pub fn colors(show: Show, rendered: &Rendered, camera: &Camera) -> Vec<u8> {
    match show {
        Show::Color => rendered.rgb.iter().map(|&value| byte(value)).collect(),
        Show::Opacity => of_each(rendered, |i| [rendered.opacity[i]; 3]),
        Show::Depth => of_each(rendered, |i| {
            colormap::color(nearness(camera, rendered.depth[i]))
        }),
        Show::Normals => of_each(rendered, |i| normal(rendered, camera, i)),
    }
}

/// A photo as it was taken, before black where it has alpha.
pub fn photo(view: &View) -> Vec<u8> {
    convert::srgb(view).into_iter().map(byte).collect()
}

/// Writes a picture.
pub fn encode(rgb: &[u8], [w, h]: [u32; 2], format: ImageFormat) -> Result<Vec<u8>, ImageError> {
    let mut file = Vec::new();
    let color = ExtendedColorType::Rgb8;
    match format {
        ImageFormat::Jpeg => {
            JpegEncoder::new_with_quality(&mut file, QUALITY).write_image(rgb, w, h, color)?;
        }
        ImageFormat::Png => {
            // Over loopback bytes cost little, and packing them costs time.
            PngEncoder::new_with_quality(&mut file, CompressionType::Fast, FilterType::Up)
                .write_image(rgb, w, h, color)?;
        }
    }
    Ok(file)
}

fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}

fn of_each(rendered: &Rendered, color: impl Fn(usize) -> [f32; 3]) -> Vec<u8> {
    (0..rendered.depth.len())
        .flat_map(|i| color(i).map(byte))
        .collect()
}

/// 1 at the camera's near and 0 at its far, even in disparity, as a picture is as fine.
fn nearness(camera: &Camera, depth: f32) -> f32 {
    let [near, far] = [camera.near as f32, camera.far as f32];
    // A depth of 0 gives infinity, which `byte` and the colour map clamp.
    (1.0 / depth - 1.0 / far) / (1.0 / near - 1.0 / far)
}

/// Which way the surface at a pixel faces, in world axes, from the depths of its neighbours: -1 to
/// 1 as 0 to 1.
fn normal(rendered: &Rendered, camera: &Camera, i: usize) -> [f32; 3] {
    let w = rendered.width as usize;
    let h = rendered.height as usize;
    let [x, y] = [i % w, i / w];
    let at = |x: usize, y: usize| {
        let depth = f64::from(rendered.depth[y * w + x]);
        DVec3::from(camera.unproject(x as f64 + 0.5, y as f64 + 0.5, depth))
    };
    let across = at((x + 1).min(w - 1), y) - at(x.saturating_sub(1), y);
    // Central differences, one-sided at the border.
    let down = at(x, (y + 1).min(h - 1)) - at(x, y.saturating_sub(1));
    // Down times across points towards the camera: y grows downwards in pictures.
    match down.cross(across).try_normalize() {
        Some(normal) if rendered.opacity[i] >= SOLID => {
            normal.as_vec3().to_array().map(|part| 0.5 * part + 0.5)
        }
        _ => [0.0; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three by three pixels of a wall at right angles to the view, which ends on the right.
    fn wall(depth: f32) -> (Rendered, Camera) {
        let rendered = Rendered {
            width: 3,
            height: 3,
            rgb: vec![0.2; 27],
            depth: vec![depth; 9],
            opacity: [1.0, 1.0, 0.0].repeat(3),
            samples: 0,
        };
        let camera = Camera::centered((3, 3), 3.0, glam::DMat4::IDENTITY, [1.0, 4.0]);
        (rendered, camera)
    }

    #[test]
    fn a_wall_faces_who_looks_at_it() {
        let (rendered, camera) = wall(2.0);
        let row = [[128, 128, 255], [128, 128, 255], [0; 3]].concat();
        assert_eq!(colors(Show::Normals, &rendered, &camera), row.repeat(3));
        let row = [[255; 3], [255; 3], [0; 3]].concat();
        assert_eq!(colors(Show::Opacity, &rendered, &camera), row.repeat(3));
        assert_eq!(colors(Show::Color, &rendered, &camera), [51; 27]);
    }

    #[test]
    fn depths_have_the_colours_of_their_disparities() {
        for (depth, nearness) in [(1.0, 1.0), (1.6, 0.5), (4.0, 0.0), (9.0, 0.0)] {
            let (rendered, camera) = wall(depth);
            let expected = colormap::color(nearness).map(byte).repeat(9);
            assert_eq!(colors(Show::Depth, &rendered, &camera), expected, "{depth}");
        }
    }
}
