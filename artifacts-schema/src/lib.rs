//! What lies on disk: one file per artifact type, its codec and its semantic digest.
//!
//! Knows files, units and conventions (`docs/artifacts.md`); knows nothing of stages, keys or the
//! store.
//!
//! ```
//! use artifacts_schema::Digest;
//!
//! let digest: Digest = blake3::hash(b"what is in an artifact").into();
//! assert_eq!(digest.to_string().parse::<Digest>().ok(), Some(digest));
//! ```

pub mod artifact;
mod canonical;
pub mod digest;
pub mod error;
pub mod field;
pub mod figures;
pub mod film;
pub mod image_stream;
pub mod images;
pub mod latent_heads;
pub mod latent_stream;
pub mod latents;
pub mod log;
pub mod lora;
pub mod metrics;
pub mod provenance;
pub mod schemas;
mod tensors;
mod transforms;

pub use artifact::{Artifact, ArtifactKind, semantic_digest};
pub use digest::Digest;
pub use error::SchemaError;
pub use field::Field;
pub use figures::{FigureWriter, Figures, Picture};
pub use film::Film;
pub use image_stream::{ImageWriter, StoredImages};
pub use images::{ImageSet, View};
pub use latent_heads::{LatentHead, LatentHeads};
pub use latent_stream::{LatentWriter, StoredLatents};
pub use latents::{LatentView, Latents, Residuals};
pub use log::Log;
pub use lora::Lora;
pub use metrics::{Metrics, Row};
pub use provenance::Provenance;
