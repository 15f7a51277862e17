//! Between what lies on disk and what the libraries take. Knows nothing of any one stage.

mod images;
mod optimization;
mod tensors;
#[cfg(test)]
mod tests;

pub use images::{
    alpha_array, disk_pixels, disk_pixels_of_signed, linear_array, photo_view, pixels, place_named,
    rendered_view, signed_array, srgb, srgb_array, srgb_before, train_view, view_named, view_photo,
};
pub use optimization::{optimization_checkpoint, optimization_state};
pub use tensors::{disk_field, field, latent_array, latent_named, lora, tensor};

use crate::error::StageError;

/// Refuses a whole-number parameter outside `min..=max`.
pub fn in_range(field: &'static str, value: u32, min: u32, max: u32) -> Result<(), StageError> {
    if (min..=max).contains(&value) {
        return Ok(());
    }
    let bound = if value < min {
        format!("at least {min}")
    } else {
        format!("at most {max}")
    };
    Err(StageError::parameter(
        field,
        format!("is {value}; it must be {bound}"),
    ))
}

/// Refuses a number outside `min..=max`, and NaN, which is in no range.
pub fn number_in_range(
    field: &'static str,
    value: f64,
    min: f64,
    max: f64,
) -> Result<(), StageError> {
    if (min..=max).contains(&value) {
        return Ok(());
    }
    Err(StageError::parameter(
        field,
        format!("is {value}; it must be {min} to {max}"),
    ))
}
