//! The stages, one file each kind: thin over the libraries beside them. Knows nothing of the
//! runner.
//!
//! ```
//! use stages::Stage;
//! use stages::kinds::fit::Fit;
//!
//! let fit = Fit { steps: 0, ..Fit::default() };
//! let refused = fit.check().unwrap_err().to_string();
//! assert!(refused.contains("steps"), "{refused}");
//! ```

pub mod back_projection;
pub mod checkpoint;
pub mod checkpointer;
pub mod colormap;
pub mod convert;
pub mod dataset;
pub mod error;
pub mod files;
pub mod io;
pub mod kinds;
pub mod masks;
pub mod merge;
pub mod model;
pub mod photos;
pub mod ply;
pub mod port;
pub mod prior;
pub mod registry;
pub mod shard;
pub mod size;
pub mod splats;
pub mod stage;
pub mod surface;
pub mod training;

pub use error::StageError;
pub use io::{Io, Message};
pub use kinds::evaluate::metric_rank;
pub use merge::Merge;
pub use port::{Input, InputPort, OutputPort, Port};
pub use registry::{AnyStage, KINDS};
pub use size::{Foretold, Size, Sizes};
pub use stage::{Determinism, Estimate, Extension, Source, Stage};
