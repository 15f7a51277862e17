//! Fields in a browser: a page on this machine's loopback asks for cameras and gets pictures.
//!
//! Others serve, one thread renders: what the newest camera sees, coarse first, then finer. It
//! leaves a picture as soon as a newer camera is there, or whoever asked has gone. Knows nothing of
//! pipelines.

mod look;
mod newest;
mod page;
mod painter;
pub mod picture;
mod server;
mod subject;

pub use server::Server;
pub use subject::Subject;
