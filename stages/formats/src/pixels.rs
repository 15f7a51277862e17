//! The colours of a picture, with their colour space in the type, so that no one takes the one for
//! the other. Knows no size and no camera.

use std::marker::PhantomData;

use crate::color::{linear_to_srgb, srgb_to_linear};

/// Scene-linear Rec.709, multiplied by alpha: what EXR files hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Linear {}

/// sRGB-encoded, nominally 0 to 1, *not* multiplied by alpha: what photos are, and what fields,
/// networks and metrics take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Srgb {}

/// Colours and coverage of a picture in a colour space, [`Linear`] or [`Srgb`].
#[derive(Clone, Debug, PartialEq)]
pub struct Pixels<Space> {
    /// `height * width * 3` values, rows from the top, channels interleaved.
    pub rgb: Vec<f32>,
    /// Coverage from 0 to 1, `height * width` values; `None` for an opaque picture.
    pub alpha: Option<Vec<f32>>,
    space: PhantomData<Space>,
}

impl<Space> Pixels<Space> {
    /// These colours, which must be of this space.
    pub fn new(rgb: Vec<f32>, alpha: Option<Vec<f32>>) -> Self {
        Self {
            rgb,
            alpha,
            space: PhantomData,
        }
    }

    /// A picture that covers all of its pixels.
    pub fn opaque(rgb: Vec<f32>) -> Self {
        Self::new(rgb, None)
    }

    /// How much of a pixel is covered.
    pub fn coverage(&self, pixel: usize) -> f32 {
        self.alpha.as_ref().map_or(1.0, |alpha| alpha[pixel])
    }

    /// The numbers of all colours, each told its pixel's coverage.
    fn map(&self, value: impl Fn(f32, f32) -> f32) -> Vec<f32> {
        let numbers = self.rgb.iter().enumerate();
        numbers
            .map(|(i, &x)| value(x, self.coverage(i / 3)))
            .collect()
    }
}

impl Pixels<Linear> {
    /// This picture sRGB-encoded; where nothing is covered, black.
    pub fn encoded(&self) -> Pixels<Srgb> {
        // In files colours are times coverage, in linear light: divided before they are encoded.
        let rgb = self.map(|x, part| match part > 0.0 {
            true => linear_to_srgb(x / part),
            false => 0.0,
        });
        Pixels::new(rgb, self.alpha.clone())
    }
}

impl Pixels<Srgb> {
    /// This picture in linear light, premultiplied.
    pub fn linear(&self) -> Pixels<Linear> {
        // Decoded before it is multiplied: coverage is a share of light.
        let rgb = self.map(|x, part| srgb_to_linear(x) * part);
        Pixels::new(rgb, self.alpha.clone())
    }

    /// The picture before a grey of this value. Composited as radiance fields are, and as
    /// NeRF-synthetic's truth is: on encoded values.
    pub fn before(self, grey: f32) -> Self {
        match self.alpha {
            None => self,
            // On encoded values, as NeRF-synthetic does it.
            Some(_) => Self::opaque(self.map(|x, part| part * x + (1.0 - part) * grey)),
        }
    }

    /// What gives the colours `before_black` when `alpha` of it is in front of black; what lies
    /// outside 0 to 1 is clipped.
    pub fn of_before_black(before_black: Vec<f32>, alpha: Option<Vec<f32>>) -> Self {
        let mut pixels = Self::new(before_black, alpha);
        pixels.rgb = pixels.map(|x, part| match part > 0.0 {
            // Where coverage is small the division enlarges what was rounded.
            true => (x / part).clamp(0.0, 1.0),
            false => 0.0,
        });
        pixels
    }
}

/// The planes of interleaved values, one for each of so many channels.
pub fn planes(interleaved: &[f32], channels: usize) -> Vec<f32> {
    (0..channels)
        .flat_map(|channel| interleaved.iter().skip(channel).step_by(channels).copied())
        .collect()
}

/// Interleaved values of so many planes.
pub fn interleaved(planes: &[f32], channels: usize) -> Vec<f32> {
    let size = planes.len() / channels;
    (0..size)
        .flat_map(|i| (0..channels).map(move |channel| planes[channel * size + i]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_comes_back_from_linear_light() {
        let rgb = [0.0, 0.2, 1.0, 0.5, 0.5, 0.1];
        let picture: Pixels<Srgb> = Pixels::new(rgb.to_vec(), Some(vec![0.5, 1.0]));
        let back = picture.linear().encoded();
        let near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-6;
        assert!(back.rgb.iter().zip(&rgb).all(near), "{back:?}");
        assert_eq!(back.alpha, picture.alpha);
    }

    #[test]
    fn what_is_not_covered_shows_what_is_behind() {
        let picture: Pixels<Srgb> = Pixels::new(vec![0.8; 6], Some(vec![0.0, 0.5]));
        let before = picture.clone().before(0.2);
        assert_eq!(before.rgb[..3], [0.2; 3]);
        assert!((before.rgb[3] - 0.5).abs() < 1e-6 && before.alpha.is_none());
        let black = picture.before(0.0).rgb;
        let back = Pixels::of_before_black(black, Some(vec![0.0, 0.5]));
        assert_eq!(back.rgb, [0.0, 0.0, 0.0, 0.8, 0.8, 0.8]);
    }

    #[test]
    fn planes_are_undone() {
        let values = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        assert_eq!(planes(&values, 3), [0.0, 3.0, 1.0, 4.0, 2.0, 5.0]);
        assert_eq!(interleaved(&planes(&values, 3), 3), values);
    }
}
