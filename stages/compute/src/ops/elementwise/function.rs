//! The functions of one or two numbers that every back end has kernels for. Operators name them; a
//! back end matches on them, so that a new one cannot be forgotten. They know single elements only.

/// A function of one element `x`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Unary {
    /// The product with a constant.
    Scale(f32),
    /// The nearest number in `low..=high`; NaN stays NaN.
    Clamp { low: f32, high: f32 },
    /// The sum with a constant.
    Offset(f32),
    /// -1, 0 or 1.
    Sign,
    /// `x` above 0, the constant times `x` below.
    Leaky(f32),
    /// `1 / (1 + exp(-x))`.
    Sigmoid,
    /// `x sigmoid(x)`.
    Silu,
    /// `x Phi(x)`, Phi being the distribution function of the standard normal.
    Gelu,
    /// `x sigmoid(1.702 x)`.
    QuickGelu,
}

/// A function of two elements `x` and `y`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Binary {
    /// `x y`.
    Product,
    /// `a x + b y`, each product rounded by itself.
    Sum([f32; 2]),
    /// `y` times the derivative of [`Unary::Silu`] at `x`.
    SiluSlope,
    /// `y` times the derivative of [`Unary::Gelu`] at `x`.
    GeluSlope,
    /// `y` times the derivative of [`Unary::QuickGelu`] at `x`.
    QuickGeluSlope,
}

/// A number from all elements of an array, in `f64`; 0 if there are none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reduction {
    Sum,
    SumOfSquares,
    /// The largest magnitude; NaN elements are passed over.
    MaxAbs,
}
