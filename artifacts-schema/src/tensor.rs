//! Numbers with a shape. Knows no files.

use crate::error::SchemaError;

/// A dense f32 tensor, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensor {
    /// The extent of each dimension.
    pub shape: Vec<usize>,
    /// The values; as many as the product of the extents.
    pub values: Vec<f32>,
}

impl Tensor {
    /// Refuses values that do not fill the shape.
    pub(crate) fn check(&self, place: &str) -> Result<(), SchemaError> {
        let count = self
            .shape
            .iter()
            .try_fold(1usize, |count, &extent| count.checked_mul(extent));
        if count == Some(self.values.len()) {
            return Ok(());
        }
        let shape = &self.shape;
        let len = self.values.len();
        Err(SchemaError::content(
            place,
            format!("{len} values do not fill the shape {shape:?}"),
        ))
    }
}
