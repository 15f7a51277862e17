//! What `Scene` writes, photo by photo, and which photos it holds out. Knows nothing of sources.

use artifacts_schema::{ImageSet, ImageWriter, View};
use formats::{Bounds, rows};
use glam::DMat4;

use crate::error::StageError;
use crate::io::Io;
use crate::port::Port;

/// Low-resolution photos to train on.
pub const TRAIN: Port<ImageSet> = Port::new("train");
/// Held-out photos at full resolution.
pub const TEST: Port<ImageSet> = Port::new("test");
/// The same at low resolution.
pub const TEST_LOW: Port<ImageSet> = Port::new("test_low");

/// Which photos are held out, by their numbers.
pub struct Split {
    /// How many there are.
    pub photos: usize,
    /// The first of those that the source itself sets aside, if it does.
    pub aside: Option<usize>,
    /// Where it does not, every so many photos one is held out.
    pub every: usize,
}

impl Split {
    /// Whether the photo of this number is held out.
    pub fn holds_out(&self, at: usize) -> bool {
        match self.aside {
            Some(first) => at >= first,
            None => at.is_multiple_of(self.every),
        }
    }
}

/// A photo as it is written.
pub struct Ready {
    /// At low resolution.
    pub low: View,
    /// At full resolution, if it is held out.
    pub full: Option<View>,
}

/// The outputs, photo by photo.
pub struct Sets<'i> {
    train: ImageWriter<'i>,
    test: ImageWriter<'i>,
    test_low: ImageWriter<'i>,
    /// Photos that were taken.
    pub done: usize,
}

impl<'i> Sets<'i> {
    /// In this box, and with this way back to the source's coordinates.
    pub fn new(io: &'i Io, bounds: Bounds, to_source: DMat4) -> Self {
        // Without it readers know that the scene's coordinates are the source's.
        let to_source = (to_source != DMat4::IDENTITY).then(|| rows::of(&to_source));
        let [train, test, test_low] =
            [TRAIN, TEST, TEST_LOW].map(|port| io.image_writer(port, bounds, to_source));
        Self {
            train,
            test,
            test_low,
            done: 0,
        }
    }

    /// Takes a photo.
    pub fn add(&mut self, Ready { low, full }: Ready) -> Result<(), StageError> {
        match full {
            Some(full) => {
                self.test.add(full)?;
                self.test_low.add(low)?;
            }
            None => self.train.add(low)?,
        }
        self.done += 1;
        Ok(())
    }

    /// Ends the sets.
    pub fn finish(self) -> Result<(), StageError> {
        for set in [self.train, self.test, self.test_low] {
            set.finish()?;
        }
        Ok(())
    }
}
