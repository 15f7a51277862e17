//! The extents of a group normalisation, and what follows it. They know no values.

/// What follows a group normalisation in the same pass over memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    None,
    /// `y sigmoid(y)`.
    Silu,
}

/// The extents of a group normalisation over `[N, C, ..]`.
#[derive(Clone, Copy, Debug)]
pub struct Groups {
    /// Channels in all.
    pub channels: usize,
    /// Groups per image.
    pub groups: usize,
    /// Elements per channel.
    pub plane: usize,
    pub eps: f32,
}
