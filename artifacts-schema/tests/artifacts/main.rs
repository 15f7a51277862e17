//! What artifacts promise: they come back exactly, equal ones are equal files, digests see content
//! only, and no file makes a reader panic.

#![allow(clippy::unwrap_used)] // A test may panic.

mod bytes;
mod digests;
mod latent_streams;
mod malformed;
mod openexr;
mod round_trip;
mod samples;
mod schemas;
mod streams;
