//! What a run came to: tables of its results, its arms side by side, and a page of all that.
//! Computes no stage.

pub mod comparison;
pub mod page;
pub mod results;
