//! Matrix products on a GPU: one template of [tiles](tiling), whose factors and [epilogue] are
//! written for each product.

mod epilogue;
pub mod linear;
pub mod product;
mod reader;
mod tiling;
