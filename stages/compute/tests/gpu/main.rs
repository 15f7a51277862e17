//! What a GPU is given to do and what it can hold, on whatever adapter comes first: a software one
//! does. Where there is none the tests pass with a message, unless `SRNERF_REQUIRE_GPU` is set, as
//! `make test` does.

mod common;
mod pieces;
mod residency;
