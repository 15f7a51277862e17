//! The extents of a group normalisation, and what follows it. They know no values.

/// What follows a group normalisation in the same pass over memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// The normalised values are stored as they are.
    None,
    /// `y sigmoid(y)` of the normalised value `y`.
    Silu,
}

/// The extents of a group normalisation over `[N, C, ..]`.
#[derive(Clone, Copy, Debug)]
pub struct Groups {
    /// Channels in all, a multiple of `groups`.
    pub channels: usize,
    /// Groups that the channels of each image are divided into.
    pub groups: usize,
    /// Elements per channel: the product of the axes behind C.
    pub plane: usize,
    pub eps: f32,
}
