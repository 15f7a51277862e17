//! A 4x4 matrix in files: its rows, since that is how people and `transforms.json` write it; glam
//! holds columns. For `#[serde(with = "formats::rows")]`.

use glam::DMat4;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The rows of a matrix.
pub fn of(matrix: &DMat4) -> [[f64; 4]; 4] {
    // Rows of a matrix are the columns of its transpose.
    matrix.transpose().to_cols_array_2d()
}

/// The matrix of these rows.
pub fn matrix(rows: &[[f64; 4]; 4]) -> DMat4 {
    DMat4::from_cols_array_2d(rows).transpose()
}

/// Writes the rows.
///
/// # Errors
/// Those of the serializer.
pub fn serialize<S: Serializer>(matrix: &DMat4, serializer: S) -> Result<S::Ok, S::Error> {
    of(matrix).serialize(serializer)
}

/// Reads the rows.
///
/// # Errors
/// What is not four rows of four numbers.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<DMat4, D::Error> {
    <[[f64; 4]; 4]>::deserialize(deserializer).map(|rows| matrix(&rows))
}
