//! A frame for compositors: colours, depth and normals in one OpenEXR file, as layers of one part or
//! as parts of their own. Knows nothing of the frames before and behind it.
//!
//! Channels are `R`, `G`, `B` and `A` (scene-linear Rec.709, premultiplied), `depth.Z` (along the view
//! axis, in scene units), `N.X`, `N.Y`, `N.Z` (unit, along the world's axes; 0 where there is no
//! surface) and `mask` (1 where a pixel counts). In parts, `depth` holds `Z` and `N` holds `X`, `Y`
//! and `Z`.

use std::io::Cursor;

use exr::meta::attribute::{IntegerBounds, Text};
use exr::meta::header::ImageAttributes;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer,
    LayerAttributes, LineOrder, Vec2, WritableImage, f16,
};

use super::write::{attributes, image_attributes};
use super::{ExrError, MASK};
use crate::shot::Rate;
use crate::{Camera, Linear, Pixels};

/// The parts' names, where there are several.
const COLORS: &str = "rgba";
const DEPTH: &str = "depth";
const NORMALS: &str = "N";

/// What a frame holds.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'f> {
    /// The camera that it was seen with, which goes into the header.
    pub camera: &'f Camera,
    /// Colours, scene-linear and premultiplied, and coverage.
    pub pixels: &'f Pixels<Linear>,
    /// Height x width, depth along the viewing axis in scene units.
    pub depth: Option<&'f [f32]>,
    /// Height x width, the unit normal along the world's axes, or zero.
    pub normals: Option<&'f [[f32; 3]]>,
    /// Height x width, which pixels count where some do not.
    pub mask: Option<&'f [bool]>,
    /// The name of the view: the attribute `comments`.
    pub name: &'f str,
    /// The text of the attribute `srnerf`.
    pub about: &'f str,
}

/// How a frame is written.
#[derive(Clone, Copy, Debug)]
pub struct FrameOptions {
    /// Each layer as a part of its own.
    pub parts: bool,
    /// Colours, normals and masks as 16-bit floats. Depths always have 32 bits.
    pub half: bool,
    /// How pixels are packed.
    pub packing: Packing,
    /// Frames a second, if it is one of a sequence.
    pub rate: Option<Rate>,
}

/// How pixels are packed. DWAA and DWAB lose a little, all others nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// Numbers as they are.
    None,
    /// Runs of equal bytes.
    Rle,
    /// Deflate, line by line.
    Zips,
    /// Deflate, 16 lines at a time.
    Zip,
    /// Wavelets and Huffman's code.
    Piz,
    /// Cosine transforms, 32 lines at a time.
    Dwaa,
    /// Cosine transforms, 256 lines at a time.
    Dwab,
}

impl Packing {
    fn compression(self) -> Compression {
        match self {
            Self::None => Compression::Uncompressed,
            Self::Rle => Compression::RLE,
            Self::Zips => Compression::ZIP1,
            Self::Zip => Compression::ZIP16,
            Self::Piz => Compression::PIZ,
            // Nothing said, that is the level that the format's own library takes.
            Self::Dwaa => Compression::DWAA(None),
            Self::Dwab => Compression::DWAB(None),
        }
    }
}

/// The channels of a part, and its name.
type Group = (&'static str, Vec<AnyChannel<FlatSamples>>);

impl Frame<'_> {
    /// The file, the same for the same frame.
    ///
    /// # Errors
    /// Texts and sizes that OpenEXR cannot hold.
    pub fn to_bytes(&self, options: &FrameOptions) -> Result<Vec<u8>, ExrError> {
        let groups = match options.parts {
            true => self.groups(options.half),
            false => vec![self.one_group(options.half)],
        };
        let layers: Result<Vec<_>, ExrError> = groups
            .into_iter()
            .map(|group| self.layer(group, options))
            .collect();
        let image = Image::from_layers(self.image_attributes(), layers?);
        let mut bytes = Cursor::new(Vec::new());
        // The parallel writer may order the blocks by who comes first.
        let written = image.write().non_parallel().to_buffered(&mut bytes);
        written.map_err(ExrError::of)?;
        Ok(bytes.into_inner())
    }

    fn image_attributes(&self) -> ImageAttributes {
        let window = IntegerBounds::new(Vec2(0, 0), self.size());
        image_attributes(ImageAttributes::new(window))
    }

    fn size(&self) -> Vec2<usize> {
        Vec2(self.camera.width as usize, self.camera.height as usize)
    }

    fn layer(
        &self,
        (name, channels): Group,
        options: &FrameOptions,
    ) -> Result<Layer<AnyChannels<FlatSamples>>, ExrError> {
        let comments = Text::new_or_none(self.name);
        let attributes = LayerAttributes {
            // A single part needs no name; several must have different ones.
            layer_name: options.parts.then(|| Text::from(name)),
            comments,
            frames_per_second: options.rate.map(Rate::fraction),
            ..attributes(self.camera, self.about)?
        };
        let encoding = Encoding {
            compression: options.packing.compression(),
            blocks: Blocks::ScanLines,
            line_order: LineOrder::Increasing,
        };
        // The format demands channels in the order of their names.
        let channels = AnyChannels::sort(channels.into());
        Ok(Layer::new(self.size(), attributes, encoding, channels))
    }

    /// The parts that there is something for.
    fn groups(&self, half: bool) -> Vec<Group> {
        let pixels = self.pixels;
        let plane = |offset: usize| pixels.rgb.iter().skip(offset).step_by(3).copied().collect();
        let color = |name, values| channel(name, values, half);
        let mut colors: Vec<_> = [("R", 0), ("G", 1), ("B", 2)]
            .map(|(name, offset)| color(name, plane(offset)))
            .into();
        colors.extend(pixels.alpha.iter().map(|alpha| color("A", alpha.clone())));
        colors.extend(self.mask.map(|mask| {
            let values = mask.iter().map(|counts| f32::from(u8::from(*counts)));
            color(MASK, values.collect())
        }));
        let depth = self
            .depth
            // Always 32 bits: a half has 11 bits of precision, too few for distances.
            .map(|depth| (DEPTH, vec![channel("Z", depth.to_vec(), false)]));
        let normals = self.normals.map(|normals| {
            let axis = |axis: usize| normals.iter().map(|normal| normal[axis]).collect();
            let axes = [("X", 0), ("Y", 1), ("Z", 2)];
            let axes = axes.map(|(name, at)| channel(name, axis(at), half));
            (NORMALS, axes.into())
        });
        let colors = Some((COLORS, colors));
        [colors, depth, normals].into_iter().flatten().collect()
    }

    /// All channels in one part: all but the colours with their layer's name before their own.
    fn one_group(&self, half: bool) -> Group {
        let mut all = Vec::new();
        for (layer, channels) in self.groups(half) {
            all.extend(channels.into_iter().map(|channel| match layer {
                COLORS => channel,
                _ => AnyChannel {
                    name: Text::from(format!("{layer}.{}", channel.name).as_str()),
                    ..channel
                },
            }));
        }
        (COLORS, all)
    }
}

fn channel(name: &str, values: Vec<f32>, half: bool) -> AnyChannel<FlatSamples> {
    let samples = match half {
        true => FlatSamples::F16(values.into_iter().map(to_half).collect()),
        false => FlatSamples::F32(values),
    };
    AnyChannel::new(name, samples)
}

/// The nearest 16-bit float; what is brighter than they reach is as bright as they reach.
fn to_half(value: f32) -> f16 {
    let largest = f32::from(f16::MAX);
    match value.is_finite() {
        // Beyond a half's range it would become infinite.
        true => f16::from_f32(value.clamp(-largest, largest)),
        false => f16::from_f32(value),
    }
}

#[cfg(test)]
mod tests;
