//! Posed photos, and the scenes made of them. Knows nothing of where they come from.

use formats::{Bounds, Camera, Pixels, Srgb};
use glam::DMat4;

/// One image with the camera that took it.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    /// The name it sorts by, without extension: `image003`, `view_003`.
    pub name: String,
    /// The camera, at this image's size.
    pub camera: Camera,
    /// What is on it, 0 to 1; with alpha where the file has it.
    pub pixels: Pixels<Srgb>,
    /// Which pixels count, `height * width` values, where some do not: a mask, or a fisheye's rim.
    pub mask: Option<Vec<bool>>,
}

/// A scene: what was photographed, from where, and how far it reaches.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneData {
    /// The photos at full resolution, sorted by name. They are the truth that metrics compare with.
    pub photos: Vec<Photo>,
    /// Photos that the source itself sets aside for testing, sorted by name; empty where it leaves
    /// that to others.
    pub test: Vec<Photo>,
    /// Lowest and highest corner, in world units, of an axis-aligned box around all that the
    /// cameras see.
    pub bounds: Bounds,
    /// The similarity that takes the scene's coordinates to those of the files that it was read
    /// from.
    pub to_source: DMat4,
    /// One line for people: what it is and how it was brought into its coordinates.
    pub description: String,
    /// What was left out or had to be guessed: a sentence each.
    pub notes: Vec<String>,
}

/// Splits photos in their order into `(train, test)`: indices 0, `every`, 2 * `every`, ... are held
/// out as test, which with 8 is the LLFF protocol. 0 holds out nothing; 1 holds out everything.
pub fn split_holdout(photos: Vec<Photo>, every: usize) -> (Vec<Photo>, Vec<Photo>) {
    let is_test = |index: usize| every != 0 && index.is_multiple_of(every);
    let (test, train): (Vec<_>, Vec<_>) = photos
        .into_iter()
        .enumerate()
        .partition(|(index, _)| is_test(*index));
    let photos_of = |part: Vec<(usize, Photo)>| part.into_iter().map(|(_, photo)| photo).collect();
    (photos_of(train), photos_of(test))
}

#[cfg(test)]
mod tests {
    use super::*;
    use formats::Distortion;

    fn photos(count: usize) -> Vec<Photo> {
        let camera = Camera {
            width: 1,
            height: 1,
            fl_x: 1.0,
            fl_y: 1.0,
            cx: 0.5,
            cy: 0.5,
            distortion: Distortion::default(),
            camera_to_world: DMat4::IDENTITY,
            near: 1.0,
            far: 2.0,
        };
        let photo = |i| Photo {
            name: format!("{i}"),
            camera,
            pixels: Pixels::opaque(vec![0.0; 3]),
            mask: None,
        };
        (0..count).map(photo).collect()
    }

    fn names(photos: &[Photo]) -> Vec<&str> {
        photos.iter().map(|photo| photo.name.as_str()).collect()
    }

    #[test]
    fn every_eighth_photo_from_the_first_is_held_out() {
        let (train, test) = split_holdout(photos(20), 8);
        assert_eq!(names(&test), ["0", "8", "16"]);
        assert_eq!(train.len(), 17);
        assert_eq!(names(&train)[..8], ["1", "2", "3", "4", "5", "6", "7", "9"]);
    }

    #[test]
    fn zero_holds_out_nothing_and_one_everything() {
        assert_eq!(split_holdout(photos(3), 0).1.len(), 0);
        assert_eq!(split_holdout(photos(3), 1).0.len(), 0);
    }
}
