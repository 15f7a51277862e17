//! The stage kinds, one file each: thin over the libraries beside them.

pub mod error;
pub mod registry;
pub mod stage;

pub use error::StageError;
pub use registry::{AnyStage, KINDS};
pub use stage::{Determinism, Input, InputPort, Io, Message, OutputPort, Source, Stage};
