//! The guidance rules and the optimisation, against identities, closed forms and a reference in PyTorch.

mod fixed_points;
mod gaussian;
mod golden;
mod rules;
mod run;
