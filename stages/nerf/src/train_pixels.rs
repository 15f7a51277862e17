//! The colours of a photo to train on: in memory, or in a file where all photos together are too
//! large for it. Knows nothing of cameras and batches.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use formats::{Pixels, Srgb};

/// What was seen, sRGB-encoded; colours are not multiplied by coverage.
#[derive(Clone, Debug)]
pub enum TrainPixels {
    /// In memory.
    Kept(Pixels<Srgb>),
    /// In a file, from which pixels are read as they are drawn.
    Stored(StoredPixels),
}

impl From<Pixels<Srgb>> for TrainPixels {
    fn from(pixels: Pixels<Srgb>) -> Self {
        Self::Kept(pixels)
    }
}

impl TrainPixels {
    /// Colour and coverage of a pixel, counted row by row from the top.
    pub fn pixel(&self, at: usize) -> ([f32; 3], f32) {
        match self {
            Self::Kept(pixels) => {
                let rgb = std::array::from_fn(|channel| pixels.rgb[3 * at + channel]);
                (rgb, pixels.coverage(at))
            }
            Self::Stored(stored) => stored.pixel(at),
        }
    }

    /// Panics if it has not as many pixels as its camera: photos are checked where they are read.
    pub(crate) fn check(&self, pixels: usize) {
        match self {
            Self::Kept(kept) => {
                assert_eq!(
                    kept.rgb.len(),
                    3 * pixels,
                    "a training view's colours do not fit its camera"
                );
                let fits = |alpha: &Vec<f32>| alpha.len() == pixels;
                assert!(
                    kept.alpha.as_ref().is_none_or(fits),
                    "a training view's alpha does not fit"
                );
            }
            Self::Stored(stored) => assert_eq!(
                stored.pixels, pixels,
                "a training view's colours do not fit its camera"
            ),
        }
    }
}

/// A photo in a [`PixelFile`].
#[derive(Clone, Debug)]
pub struct StoredPixels {
    file: Arc<PixelFile>,
    /// Where its first pixel stands.
    offset: u64,
    pixels: usize,
    has_alpha: bool,
}

impl StoredPixels {
    fn pixel(&self, at: usize) -> ([f32; 3], f32) {
        // r, g, b, and coverage where there is any.
        let mut record = [0.0, 0.0, 0.0, 1.0];
        let length = if self.has_alpha { 4 } else { 3 };
        let bytes = bytemuck::cast_slice_mut(&mut record[..length]);
        let place = self.offset + (at * bytes.len()) as u64;
        if let Err(error) = read_at(&self.file.file, bytes, place) {
            // Whoever trains asks for it after the step. Only the first is of use.
            let _ = self.file.fault.set(error);
        }
        let [r, g, b, coverage] = record;
        ([r, g, b], coverage)
    }
}

/// Photos one after the other in a file of this machine's numbers: no format to keep. What of it is
/// in memory is up to the operating system, which may take that back at any time.
#[derive(Debug)]
pub struct PixelFile {
    file: File,
    /// The first read that failed. Reads are made by all threads in the middle of a step.
    fault: OnceLock<io::Error>,
}

impl PixelFile {
    /// An empty file in place of whatever is there.
    ///
    /// # Errors
    /// A file system that refuses.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut options = File::options();
        options.read(true).write(true).create(true).truncate(true);
        Ok(Self {
            file: options.open(path)?,
            fault: OnceLock::new(),
        })
    }

    /// Appends a photo. All are there before the first pixel is read.
    ///
    /// # Errors
    /// A file system that refuses, or is full.
    pub fn add(self: &Arc<Self>, photo: &Pixels<Srgb>) -> io::Result<StoredPixels> {
        let offset = self.file.metadata()?.len();
        let mut file = &self.file;
        match &photo.alpha {
            None => file.write_all(bytemuck::cast_slice(&photo.rgb))?,
            Some(alpha) => {
                let pixels = photo.rgb.as_chunks::<3>().0.iter().zip(alpha);
                let records: Vec<[f32; 4]> = pixels
                    .map(|([r, g, b], coverage)| [*r, *g, *b, *coverage])
                    .collect();
                file.write_all(bytemuck::cast_slice(&records))?;
            }
        }
        Ok(StoredPixels {
            file: self.clone(),
            offset,
            pixels: photo.rgb.len() / 3,
            has_alpha: photo.alpha.is_some(),
        })
    }

    /// What went wrong with the first pixel that could not be read, in whose place was black.
    pub fn fault(&self) -> Option<&io::Error> {
        self.fault.get()
    }
}

#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], place: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, place)
}

#[cfg(windows)]
fn read_at(file: &File, bytes: &mut [u8], place: u64) -> io::Result<()> {
    // A pixel is a few bytes within a block of the file, which comes whole.
    let read = std::os::windows::fs::FileExt::seek_read(file, bytes, place)?;
    match read == bytes.len() {
        true => Ok(()),
        false => Err(io::ErrorKind::UnexpectedEof.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stored_photo_has_the_pixels_of_the_kept_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = Arc::new(PixelFile::create(&folder.path().join("photos")).unwrap());
        let rgb: Vec<f32> = (0..12).map(|i| i as f32 / 7.0).collect();
        let photos = [
            Pixels::opaque(rgb.clone()),
            Pixels::new(rgb, Some(vec![0.0, 0.25, 0.5, 1.0])),
        ];
        // Both are there before either is read.
        let stored = photos.each_ref().map(|photo| file.add(photo).unwrap());
        for (photo, stored) in photos.into_iter().zip(stored) {
            let [kept, stored] = [TrainPixels::Kept(photo), TrainPixels::Stored(stored)];
            stored.check(4);
            for at in 0..4 {
                assert_eq!(stored.pixel(at), kept.pixel(at));
            }
        }
        assert!(file.fault().is_none());
    }

    #[test]
    fn a_pixel_that_cannot_be_read_is_told_of_afterwards() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photos");
        let file = Arc::new(PixelFile::create(&path).unwrap());
        let stored = file.add(&Pixels::opaque(vec![0.5; 6])).unwrap();
        File::options()
            .write(true)
            .open(&path)
            .unwrap()
            .set_len(12)
            .unwrap();
        assert_eq!(stored.pixel(0), ([0.5; 3], 1.0));
        assert!(file.fault().is_none());
        stored.pixel(1);
        assert_eq!(file.fault().unwrap().kind(), io::ErrorKind::UnexpectedEof);
    }
}
