//! What files may say of a camera. Knows no poses that are merely unlikely.

use super::Camera;

/// Images are at most this wide and high.
// Sizes come from files; with this bound areas stay far below `usize`.
const LARGEST_EXTENT: u32 = 1 << 16;

/// Why numbers are no camera; they follow on the name of the view.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// A size that no image has.
    #[error("is {width}x{height}; expected 1 to {LARGEST_EXTENT} pixels each way")]
    Size {
        /// Pixels in a row.
        width: u32,
        /// Rows of pixels.
        height: u32,
    },
    /// A number that JSON cannot hold.
    #[error("its camera holds {0}; all must be finite")]
    NotFinite(f64),
    /// A pose that cannot be inverted.
    #[error("its camera-to-world matrix cannot be inverted")]
    Singular,
}

impl Camera {
    /// Refuses what no file may say: see [`CameraError`].
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self) -> Result<(), CameraError> {
        let extents = 1..=LARGEST_EXTENT;
        if !extents.contains(&self.width) || !extents.contains(&self.height) {
            return Err(CameraError::Size {
                width: self.width,
                height: self.height,
            });
        }
        // JSON writes null for what is not finite, and null does not read back.
        if let Some(number) = self.numbers().find(|number| !number.is_finite()) {
            return Err(CameraError::NotFinite(number));
        }
        // Projecting inverts the pose.
        match self.camera_to_world.determinant() == 0.0 {
            true => Err(CameraError::Singular),
            false => Ok(()),
        }
    }

    /// All but its size.
    fn numbers(&self) -> impl Iterator<Item = f64> {
        let lens = [self.fl_x, self.fl_y, self.cx, self.cy, self.near, self.far];
        let bent = self.distortion.coefficients();
        let pose = self.camera_to_world.to_cols_array();
        lens.into_iter().chain(bent).chain(pose)
    }
}
