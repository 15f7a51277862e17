//! The pictures of an evaluation: truth and renders side by side, each of them alone, and what FLIP
//! sees between them. Knows nothing of fields.

use std::collections::BTreeMap;

use artifacts_schema::{Picture, View};
use metrics::{Image, Panel};
use nerf::Rendered;

use crate::colormap;
use crate::convert;

/// What is behind a truth with alpha, and behind the fields that are measured against it: white, as
/// NeRF-synthetic has it.
pub const BEHIND: f32 = 1.0;

/// An image in sRGB-encoded values, interleaved.
pub struct Picked {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue of each pixel, from 0 to 1.
    pub rgb: Vec<f32>,
}

impl Picked {
    /// A photo, put before [`BEHIND`] where it is transparent.
    pub fn of(view: &View) -> Self {
        Self {
            width: view.camera.width as usize,
            height: view.camera.height as usize,
            rgb: convert::srgb_before(view, BEHIND),
        }
    }

    /// A render, put before its background.
    pub fn rendered(image: &Rendered) -> Self {
        Self {
            width: image.width as usize,
            height: image.height as usize,
            rgb: image.rgb.clone(),
        }
    }

    /// The image with the truth's own pixels where the truth is masked, so that these do not count.
    pub fn masked_by(mut self, truth: &Picked, mask: Option<&[bool]>) -> Self {
        let places = mask.into_iter().flatten().enumerate();
        for (i, _) in places.filter(|(_, counts)| !**counts) {
            let pixel = 3 * i..3 * i + 3;
            // The truth's and not black: edges around a masked region would be errors to windowed
            // metrics.
            self.rgb[pixel.clone()].copy_from_slice(&truth.rgb[pixel]);
        }
        self
    }

    /// The image at the exposure of the truth, as far as a gain and an offset per channel go.
    pub fn exposed_as(&self, truth: &Picked, mask: Option<&[bool]>) -> Self {
        Self {
            rgb: metrics::exposed(self.image(), truth.image(), mask),
            ..*self
        }
    }

    /// It as the metrics see it.
    pub fn image(&self) -> Image<'_> {
        Image::new(self.width, self.height, &self.rgb)
    }

    /// It as a file that any program shows.
    pub fn picture(&self) -> Picture {
        let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
        picture(
            self.width,
            self.height,
            self.rgb.iter().copied().map(byte).collect(),
        )
    }
}

fn picture(width: usize, height: usize, rgb8: Vec<u8>) -> Picture {
    Picture {
        width: width as u32,
        height: height as u32,
        rgb8,
        legend: BTreeMap::new(),
    }
}

/// Truth and images side by side, each with its PSNR.
pub fn side_by_side(truth: &Picked, images: &[(&str, &Picked)]) -> Picture {
    let psnr = |image: &Picked| format!("{:.2} dB", metrics::psnr(truth.image(), image.image()));
    let texts: Vec<_> = images
        .iter()
        .map(|(name, image)| (name.replace('_', " "), psnr(image)))
        .collect();
    let mut panels = vec![Panel {
        label: "truth",
        note: "",
        image: truth.image(),
    }];
    for ((label, note), (_, image)) in texts.iter().zip(images) {
        panels.push(Panel {
            label,
            note,
            image: image.image(),
        });
    }
    let figure = metrics::comparison(&panels);
    picture(figure.width, figure.height, figure.rgb8)
}

/// What FLIP sees between an image and the truth, from dark (nothing) to bright.
pub fn error_map(truth: &Picked, image: &Picked) -> Picture {
    let map = metrics::flip(truth.image(), image.image()).map;
    let byte = |value: f32| (value * 255.0).round() as u8;
    let colors = map.into_iter().flat_map(colormap::color).map(byte);
    let mut picture = picture(truth.width, truth.height, colors.collect());
    picture.legend = [
        ("Title", "FLIP against the photo"),
        ("Range", "0 (dark) to 1 (bright)"),
        ("Colour map", colormap::NAME),
    ]
    .map(|(keyword, text)| (keyword.to_owned(), text.to_owned()))
    .into();
    picture
}
