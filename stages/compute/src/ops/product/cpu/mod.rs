//! Matrix products on the CPU, from the innermost loop up: a [tile] of sums in registers, the
//! [factors](factor) that are packed for it, and the [product] cut into shares for several threads.

mod bf16;
pub mod factor;
pub mod linear;
pub mod packed;
pub mod product;
pub mod tile;
