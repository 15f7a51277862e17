//! The stage kinds, one file each: thin over the libraries beside them. Knows nothing of the
//! runner.
//!
//! ```
//! use stages::Stage;
//! use stages::fit::Fit;
//!
//! let fit = Fit { steps: 0, ..Fit::default() };
//! let refused = fit.check().unwrap_err().to_string();
//! assert!(refused.contains("steps"), "{refused}");
//! ```

pub mod back_projection;
pub mod checkpoint;
pub mod colormap;
pub mod convert;
pub mod corrected;
pub mod dataset;
pub mod error;
pub mod files;
pub mod keeper;
pub mod learned;
pub mod masked;
pub mod masks;
pub mod merge;
pub mod model;
pub mod origin;
pub mod ply;
pub mod registry;
pub mod shard;
pub mod splats;
pub mod stage;
pub mod surface;
pub mod training;

pub mod blend;
pub mod decode;
pub mod encode;
pub mod evaluate;
pub mod film;
pub mod fit;
pub mod interpolate;
pub mod optimize;
pub mod render;
pub mod scene;
pub mod sync;

pub use error::StageError;
pub use evaluate::metric_rank;
pub use merge::Merge;
pub use registry::{AnyStage, KINDS};
pub use stage::{
    Determinism, Estimate, Extension, Input, InputPort, Io, Message, OutputPort, Sizes, Source,
    Stage,
};
