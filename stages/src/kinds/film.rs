//! `Film`: images as pictures that any viewer shows, and as animations. Knows nothing of where the
//! images come from.

use std::collections::BTreeMap;

use artifacts_schema::{Figures, Film as Clips, ImageSet, Picture, View};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, Frame, RgbaImage};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::StageError;
use crate::io::Io;
use crate::port::{Input, InputPort, OutputPort, Port};
use crate::stage::Stage;
use crate::{colormap, convert};

const IMAGES: Port<ImageSet> = Port::new("images");
const FILM: Port<Clips> = Port::new("film");

/// The colour quantiser's effort, from 1 (best) to 30 (fastest).
const GIF_SPEED: i32 = 10;
/// Depths below and above these parts of all do not widen the range: stray samples would flatten
/// the rest.
const RANGE: [f64; 2] = [0.01, 0.99];
/// Pixels of less opacity have no depth worth a colour.
const OPAQUE: f32 = 0.5;

/// Makes PNG pictures of all images, of their depth and opacity if they have any, and an animated
/// GIF of each.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Film {
    /// The images, shown in the order of their names.
    pub images: Input,
    /// Images per second.
    #[schemars(range(min = 0.1, max = 100))]
    pub rate: f64,
    /// The grey behind transparent images, sRGB from 0 to 1.
    #[schemars(range(min = 0, max = 1))]
    pub background: f64,
}

impl Default for Film {
    fn default() -> Self {
        Self {
            images: Input::default(),
            rate: 20.0,
            background: 1.0,
        }
    }
}

/// What of an image is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Show {
    /// What it looks like.
    Color,
    /// How far all is, as colours.
    Depth,
    /// How opaque all is, as colours.
    Opacity,
}

impl Show {
    /// In the order of the outputs.
    pub const ALL: [Self; 3] = [Self::Color, Self::Depth, Self::Opacity];

    /// The output that has it.
    pub fn port(self) -> Port<Figures> {
        Port::new(match self {
            Self::Color => "color",
            Self::Depth => "depth",
            Self::Opacity => "opacity",
        })
    }

    /// Pictures of the images that have it, in front of a grey, sRGB from 0 to 1.
    pub fn pictures(self, images: &ImageSet, background: f32) -> Figures {
        // Before the pictures, from all of them: a range for each would change the colours from
        // frame to frame.
        let range = match self {
            Self::Depth => depth_range(images),
            _ => None,
        };
        let shown = |view: &View| match self {
            Self::Color => {
                let colors = convert::srgb_before(view, background);
                Some(picture(view, colors.into_iter(), &[]))
            }
            Self::Depth => {
                let depth = view.depth.as_ref()?;
                Some(mapped(view, depth, range?, "depth along the view axis"))
            }
            Self::Opacity => {
                let alpha = view.pixels.alpha.as_ref()?;
                Some(mapped(view, alpha, [0.0, 1.0], "opacity"))
            }
        };
        let pictures = images
            .views
            .iter()
            .filter_map(|view| Some((view.name.clone(), shown(view)?)));
        Figures {
            images: pictures.collect(),
        }
    }
}

impl Film {
    /// The pictures one after the other, for ever.
    fn clip(&self, figures: &Figures) -> Result<Vec<u8>, StageError> {
        let failed =
            |error: image::ImageError| StageError::Mismatch(format!("no GIF can be made: {error}"));
        let mut bytes = Vec::new();
        let mut encoder = GifEncoder::new_with_speed(&mut bytes, GIF_SPEED);
        encoder.set_repeat(Repeat::Infinite).map_err(failed)?;
        // In the order of the map's names.
        for picture in figures.images.values() {
            let pixels = picture
                .rgb8
                .chunks_exact(3)
                .flat_map(|rgb| [rgb[0], rgb[1], rgb[2], 255])
                .collect();
            let image = RgbaImage::from_raw(picture.width, picture.height, pixels);
            let image =
                image.ok_or_else(|| StageError::Mismatch("a picture is not whole".into()))?;
            let delay = Delay::from_saturating_duration(std::time::Duration::from_secs_f64(
                1.0 / self.rate,
            ));
            encoder
                .encode_frame(Frame::from_parts(image, 0, 0, delay))
                .map_err(failed)?;
        }
        // The last byte of a GIF is written when its encoder is dropped.
        drop(encoder);
        Ok(bytes)
    }
}

fn picture(view: &View, values: impl Iterator<Item = f32>, legend: &[(&str, String)]) -> Picture {
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    Picture {
        width: view.camera.width,
        height: view.camera.height,
        rgb8: values.map(byte).collect(),
        legend: legend
            .iter()
            .map(|(keyword, text)| ((*keyword).to_owned(), text.clone()))
            .collect(),
    }
}

/// Numbers as colours, from dark to bright; the legend says which.
fn mapped(view: &View, values: &[f32], [low, high]: [f32; 2], what: &str) -> Picture {
    let scaled = values.iter().map(|value| (value - low) / (high - low));
    let legend = [
        ("Title", what.to_owned()),
        ("Range", format!("{low} (dark) to {high} (bright)")),
        ("Colour map", colormap::NAME.to_owned()),
    ];
    picture(view, scaled.flat_map(colormap::color), &legend)
}

/// The opaque pixels' depths with what strays left out: one range for all images, so that colours
/// keep their meaning.
fn depth_range(images: &ImageSet) -> Option<[f32; 2]> {
    let of_view = |view: &View| -> Vec<f32> {
        let depth = view.depth.iter().flatten().enumerate();
        depth
            // Where little is opaque, depth is a mean over what shines through.
            .filter(|(i, depth)| view.pixels.coverage(*i) >= OPAQUE && depth.is_finite())
            .map(|(_, depth)| *depth)
            .collect()
    };
    let mut depths: Vec<f32> = images.views.iter().flat_map(of_view).collect();
    // Only finite ones are left, so that percentiles have one answer.
    depths.sort_by(f32::total_cmp);
    let at = |part: f64| {
        depths
            // Without any depth there is no entry 0, and so no range.
            .get((part * depths.len().saturating_sub(1) as f64) as usize)
            .copied()
    };
    let [low, high] = [at(RANGE[0])?, at(RANGE[1])?];
    // A flat picture would divide by 0.
    Some([low, if high > low { high } else { low + 1.0 }])
}

impl Stage for Film {
    fn kind(&self) -> &'static str {
        "Film"
    }

    fn version(&self) -> u32 {
        1
    }

    fn check(&self) -> Result<(), StageError> {
        // GIF counts in hundredths of a second, so that it has no higher rate.
        if !(0.1..=100.0).contains(&self.rate) {
            return Err(StageError::parameter(
                "rate",
                format!("is {}; it must be 0.1 to 100", self.rate),
            ));
        }
        if !(0.0..=1.0).contains(&self.background) {
            return Err(StageError::parameter(
                "background",
                format!("is {}; it must be 0 to 1", self.background),
            ));
        }
        Ok(())
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        vec![IMAGES.input(&self.images)]
    }

    fn outputs(&self) -> Vec<OutputPort> {
        let mut ports = vec![FILM.output()];
        ports.extend(Show::ALL.map(|show| show.port().output()));
        ports
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        let images = io.read(IMAGES)?;
        let background = self.background as f32;
        let mut clips = BTreeMap::new();
        for (done, show) in Show::ALL.iter().enumerate() {
            let figures = show.pictures(&images, background);
            if !figures.images.is_empty() {
                clips.insert(show.port().name.to_owned(), self.clip(&figures)?);
            }
            io.write(show.port(), &figures)?;
            io.progress(done + 1, Show::ALL.len(), &[])?;
        }
        io.write(FILM, &Clips { clips })
    }
}
