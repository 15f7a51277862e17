//! How large artifacts are, or will be: what estimates of memory and time go by. Knows no stage.

use std::collections::BTreeMap;

use artifacts_schema::image_stream::{HELD, PIXEL};

/// How large an artifact is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Size {
    /// Bytes of its files; where they are not there yet, of its numbers.
    pub bytes: u64,
    /// Pixels of all of its views; 0 where it holds no images.
    pub pixels: u64,
    /// Pixels of its largest view; of latents, bytes of it.
    pub largest: u64,
    /// Its views.
    pub views: u64,
}

/// The sizes of input artifacts by input name, as far as they are known.
pub type Sizes<'a> = BTreeMap<&'a str, Size>;

/// The sizes of output artifacts by output name, as far as they can be foretold.
pub type Foretold = BTreeMap<&'static str, Size>;

/// Bytes of the largest latent, where only those of all are known: of a photo of 4000 x 3000.
const LARGEST: u64 = 12_000_000;

impl Size {
    /// Of an artifact without images.
    pub fn of_bytes(bytes: u64) -> Self {
        Self {
            bytes,
            ..Self::default()
        }
    }

    /// Of images with these widths and heights, as `bytes` on disk.
    pub fn of_images(sizes: impl IntoIterator<Item = (u32, u32)>, bytes: Option<u64>) -> Self {
        let pixels = sizes
            .into_iter()
            .map(|(width, height)| u64::from(width) * u64::from(height));
        let mut size = pixels.fold(Self::default(), |size, pixels| Self {
            pixels: size.pixels + pixels,
            largest: size.largest.max(pixels),
            views: size.views + 1,
            ..size
        });
        // Colours as they are in memory, where files are not there yet.
        size.bytes = bytes.unwrap_or(12 * size.pixels);
        size
    }

    /// Of latents that are `bytes` on disk, by the bytes of each view where those are known.
    pub fn of_latents(views: Option<Vec<u64>>, bytes: u64) -> Self {
        let largest = views.iter().flatten().copied().max();
        Self {
            largest: largest.unwrap_or(bytes.min(LARGEST)),
            views: views.map_or(0, |views| views.len() as u64),
            ..Self::of_bytes(bytes)
        }
    }

    /// Of the latents of these images, which have so many bytes for each pixel.
    pub fn encoded(self, pixel: u64) -> Self {
        Self {
            bytes: pixel * self.pixels,
            pixels: 0,
            largest: pixel * self.largest,
            views: self.views,
        }
    }

    /// Of the images of these latents, which have so many bytes for each pixel.
    pub fn decoded(self, pixel: u64) -> Self {
        let pixels = self.bytes / pixel;
        Self {
            bytes: 12 * pixels,
            pixels,
            largest: self.largest / pixel,
            views: self.views,
        }
    }

    /// Of the same images, `factor` times as wide and high.
    pub fn scaled(self, factor: f64) -> Self {
        let scaled = |number: u64| (number as f64 * factor * factor).ceil() as u64;
        Self {
            bytes: scaled(self.bytes),
            pixels: scaled(self.pixels),
            largest: scaled(self.largest),
            views: self.views,
        }
    }

    /// Of these and others together.
    pub fn and(self, other: Self) -> Self {
        Self {
            bytes: self.bytes + other.bytes,
            pixels: self.pixels + other.pixels,
            largest: self.largest.max(other.largest),
            views: self.views + other.views,
        }
    }

    /// Bytes that its images or latents take in memory when they are read view by view.
    pub fn held(&self) -> u64 {
        match self.pixels {
            // One alone, as it lies in the file, as numbers, and as an array.
            0 => 3 * self.largest.min(self.bytes),
            // So many that they fit, or one that does not.
            pixels => (PIXEL * pixels).min(HELD.max(PIXEL * self.largest)),
        }
    }

    /// Bytes that its images or latents take in memory while they wait to be written.
    pub fn waiting(&self) -> u64 {
        match self.pixels {
            0 => self.held(),
            // The one that makes them too many waits as well.
            pixels => (PIXEL * pixels).min(HELD + PIXEL * self.largest),
        }
    }

    /// Bytes that it takes in memory as a whole.
    pub fn whole(&self) -> u64 {
        match self.pixels {
            // The file, its numbers, and the arrays that they become.
            0 => 3 * self.bytes,
            pixels => 2 * PIXEL * pixels,
        }
    }
}

/// The size of the input of this name, or of something empty.
pub fn input(inputs: &Sizes, name: &str) -> Size {
    inputs.get(name).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_that_are_looked_at_one_by_one_are_not_in_memory_together() {
        let photos = Size::of_images(vec![(4032, 3024); 300], None);
        assert_eq!((photos.views, photos.largest), (300, 4032 * 3024));
        assert!(photos.whole() > 100_000_000_000);
        assert!(photos.held() < 600_000_000);
        let few = Size::of_images([(8, 8), (4, 4)], None);
        assert_eq!(few.held(), 20 * 80);
        let latents = photos.encoded(4);
        assert_eq!((latents.views, latents.held()), (300, 12 * 4032 * 3024));
        assert_eq!(latents.decoded(4), photos);
        let stored = Size::of_latents(Some(vec![32, 48]), 100);
        assert_eq!((stored.views, stored.held(), stored.whole()), (2, 144, 300));
    }
}
