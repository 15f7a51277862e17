//! Attention on the CPU, in tiles: a block of queries meets the keys tile by tile, and no more than
//! one tile of scores exists per thread.

pub mod backward;
pub mod forward;
mod head;
