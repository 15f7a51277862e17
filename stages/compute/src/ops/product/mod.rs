//! Matrix products: plain ones, and those of fully connected layers. In `cpu` and `gpu` the kernels
//! that convolution and attention use as well; they say for themselves how their factors are read.

pub mod cpu;
pub mod finish;
pub mod gpu;
pub mod linear;
pub mod matmul;
#[cfg(test)]
mod tests;
