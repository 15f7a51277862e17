//! What a product does with its results before it stores them: a pass over memory saved.

/// What becomes of a convolution's results before they are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finish<T> {
    /// They are stored as they are.
    None,
    /// `x` above 0, this slope times `x` below.
    Leaky(f32),
    /// The sum with another array of the same shape.
    Add(T),
}

impl<T> Finish<T> {
    /// Turns the other array into another form of it, such as its values on a device.
    pub(crate) fn map<U>(self, see: impl FnOnce(T) -> U) -> Finish<U> {
        match self {
            Finish::None => Finish::None,
            Finish::Leaky(slope) => Finish::Leaky(slope),
            Finish::Add(other) => Finish::Add(see(other)),
        }
    }
}
