//! Why residual latents could not be optimised.

use crate::guidance::InvalidOption;

/// Why residual latents could not be optimised.
#[derive(Debug, thiserror::Error)]
pub enum OptimizeError {
    /// An option that makes no sense.
    #[error(transparent)]
    Option(#[from] InvalidOption),
    /// There is no view to optimise.
    #[error("there are no views")]
    NoViews,
    /// A view that does not fit the others or itself.
    #[error("view `{name}` {problem}")]
    View {
        /// The name of the view that does not fit.
        name: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A state of other views or other options.
    #[error("the saved state is not of these views and this guidance")]
    OtherState,
    /// Numbers that have grown beyond all bounds.
    #[error("the latents diverged in step {step}; a lower rate or guidance scale should mend it")]
    Diverged {
        /// The step, from 0, LoRA warm-up counted in.
        step: u64,
    },
}
