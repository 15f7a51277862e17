//! What one step of Adam multiplies by. It knows no array.

/// The factors of one step, with the bias corrections folded in.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    pub beta1: f32,
    pub beta2: f32,
    pub eps: f32,
    /// `rate / (1 - beta1^t)`.
    pub rate: f32,
    /// `1 / sqrt(1 - beta2^t)`.
    pub root: f32,
    /// `1 - rate * weight_decay`.
    pub keep: f32,
}
