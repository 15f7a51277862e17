//! The guidance rules and the optimisation, against identities, closed forms and a reference in
//! PyTorch.

#![allow(clippy::unwrap_used)] // The helpers of tests are tests too.

mod fixed_points;
mod gaussian;
mod golden;
mod options;
mod rules;
mod run;
mod state;
