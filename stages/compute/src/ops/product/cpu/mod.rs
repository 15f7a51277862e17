//! Matrix products on the CPU, from the innermost loop up: a [tile] of sums in registers, the
//! [factors](factor) that are packed for it, and the [product], whose [cut] into shares serves several
//! threads.

mod bf16;
pub mod cut;
pub mod factor;
pub mod linear;
pub mod packed;
pub mod product;
pub mod tile;
