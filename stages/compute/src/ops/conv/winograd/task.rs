//! One convolution for the filtering to compute. It knows no tiles.

use crate::ops::conv::geometry::Geometry;
use crate::ops::product::finish::Finish;

/// One convolution to compute; its inputs are the weight's outputs where that is used backward.
pub struct Task<'a> {
    pub g: &'a Geometry,
    /// `[N, C, H, W]`.
    pub x: &'a [f32],
    /// `[O]`, added before the result is finished.
    pub bias: Option<&'a [f32]>,
    /// What is added is `[N, O, H', W']`.
    pub finish: Finish<&'a [f32]>,
}

impl Task<'_> {
    /// What is added to an output channel.
    pub fn bias(&self, output: usize) -> f32 {
        self.bias.map_or(0.0, |bias| bias[output])
    }
}
