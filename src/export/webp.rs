//! An animated WebP whose frames lose nothing: the container, around pictures that the `image` crate
//! encodes. Knows no image sets.
//!
//! A file is RIFF: `VP8X` (the canvas), `ANIM` (how often), and an `ANMF` for each frame, which holds
//! the chunk `VP8L` of a still picture (developers.google.com/speed/webp/docs/riff_container).

use artifacts_schema::Picture;
use formats::shot::Rate;
use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder as _, ImageError};
use rayon::prelude::*;

/// Where a still picture's own chunks begin: behind `RIFF`, the size and `WEBP`.
const HEAD: usize = 12;
/// The flag of an animation.
const ANIMATED: u8 = 1 << 1;
/// A frame replaces what was there.
const REPLACES: u8 = 1 << 1;
/// Sides are at most this long: 14 bits in a lossless picture.
const LONGEST: u32 = 1 << 14;

/// Why there is no file.
#[derive(Debug, thiserror::Error)]
pub enum WebpError {
    /// A side is too long.
    #[error("WebP holds pictures of at most {LONGEST}x{LONGEST} pixels")]
    TooLarge,
    /// All is too large.
    #[error("WebP holds at most 4 GiB")]
    TooLong,
    /// A picture is not whole.
    #[error(transparent)]
    Picture(#[from] ImageError),
}

/// The file of pictures, at least one and all of one size, shown one after the other for ever.
pub fn animation(pictures: &[Picture], rate: Rate) -> Result<Vec<u8>, WebpError> {
    let [width, height] = pictures
        .first()
        .map_or([1; 2], |one| [one.width, one.height]);
    if width > LONGEST || height > LONGEST {
        return Err(WebpError::TooLarge);
    }
    let stills: Vec<Result<Vec<u8>, ImageError>> = pictures.par_iter().map(still).collect();
    let mut body = b"WEBP".to_vec();
    let size = [
        &[ANIMATED, 0, 0, 0][..],
        &less_one(width),
        &less_one(height),
    ]
    .concat();
    chunk(&mut body, b"VP8X", &size);
    // A background nobody sees, and no end of turns.
    chunk(&mut body, b"ANIM", &[0; 6]);
    for (i, still) in stills.into_iter().enumerate() {
        // Differences of rounded moments, so that rounding does not add up over a long film.
        let lasts = rate.milliseconds(i + 1) - rate.milliseconds(i);
        // Every frame covers the whole canvas: no picture is cut down to what has changed.
        let place = [0; 6];
        // The format has 24 bits for it, which is more than four hours.
        let lasts = &(lasts as u32).to_le_bytes()[..3];
        let frame = [
            &place[..],
            &less_one(width),
            &less_one(height),
            lasts,
            &[REPLACES],
            &still?[HEAD..],
        ]
        .concat();
        chunk(&mut body, b"ANMF", &frame);
    }
    let length = u32::try_from(body.len()).map_err(|_| WebpError::TooLong)?;
    Ok([b"RIFF", &length.to_le_bytes()[..], &body].concat())
}

fn still(picture: &Picture) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::new();
    let encoder = WebPEncoder::new_lossless(&mut bytes);
    encoder.write_image(
        &picture.rgb8,
        picture.width,
        picture.height,
        ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}

/// A side as the format counts: from 1, in 24 bits.
fn less_one(side: u32) -> [u8; 3] {
    let [a, b, c, _] = (side - 1).to_le_bytes();
    [a, b, c]
}

fn chunk(into: &mut Vec<u8>, name: &[u8; 4], data: &[u8]) {
    into.extend(name);
    // A longer chunk would be cut here. The whole is then longer too, and refused.
    into.extend((data.len() as u32).to_le_bytes());
    into.extend(data);
    // RIFF chunks begin at even bytes. The length leaves out this one.
    if data.len() % 2 == 1 {
        into.push(0);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::io::Cursor;

    use image::AnimationDecoder as _;
    use image::codecs::webp::WebPDecoder;

    use super::*;

    #[test]
    fn frames_come_back_as_they_were() {
        let picture = |shift: u32| Picture {
            width: 7,
            height: 5,
            rgb8: (0..105u32).map(|i| (i * 7 + shift) as u8).collect(),
            legend: BTreeMap::new(),
        };
        let pictures: Vec<Picture> = (0..3).map(|i| picture(40 * i)).collect();
        let bytes = animation(&pictures, Rate::whole(24)).unwrap();
        let decoder = WebPDecoder::new(Cursor::new(&bytes)).unwrap();
        let frames = decoder.into_frames().collect_frames().unwrap();
        let lasts: Vec<u32> = frames
            .iter()
            .map(|frame| frame.delay().numer_denom_ms().0)
            .collect();
        assert_eq!(lasts, [42, 41, 42]);
        for (frame, picture) in frames.iter().zip(&pictures) {
            let pixels: Vec<u8> = frame
                .buffer()
                .pixels()
                .flat_map(|p| [p[0], p[1], p[2]])
                .collect();
            assert_eq!(pixels, picture.rgb8);
        }
        assert_eq!(
            bytes.len() as u32 - 8,
            u32::from_le_bytes(bytes[4..8].try_into().unwrap())
        );
    }
}
