//! The pictures that an evaluation shows, written as they come. Knows nothing of what is on them.

use artifacts_schema::FigureWriter;

use super::{FIGURES, FLIP, PHOTOS, RENDERS};
use crate::error::StageError;
use crate::io::Io;

/// What is shown of an evaluation, by view.
pub struct Album<'a> {
    /// Truth and rows side by side, of the first few views.
    pub comparisons: FigureWriter<'a>,
    /// The super-resolved field as each held-out camera sees it.
    pub renders: FigureWriter<'a>,
    /// What the camera saw.
    pub photos: FigureWriter<'a>,
    /// What FLIP sees between the two.
    pub errors: FigureWriter<'a>,
}

impl<'a> Album<'a> {
    /// An empty one, in the stage's outputs.
    pub fn new(io: &'a Io<'a>) -> Result<Self, StageError> {
        Ok(Self {
            comparisons: io.figure_writer(FIGURES)?,
            renders: io.figure_writer(RENDERS)?,
            photos: io.figure_writer(PHOTOS)?,
            errors: io.figure_writer(FLIP)?,
        })
    }

    /// Ends it.
    pub fn finish(self) -> Result<(), StageError> {
        for writer in [self.comparisons, self.renders, self.photos, self.errors] {
            writer.finish()?;
        }
        Ok(())
    }
}
