//! What can be wrong with a store, in words for people and tools. Knows not how it is found.

use std::fmt;

use artifacts_schema::Digest;
use serde::Serialize;

/// Something in a store that is not as the program left it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Where: a path in the store, or one under `out/`.
    pub path: String,
    /// What is wrong.
    #[serde(flatten)]
    pub fault: StoreFault,
    /// What it belongs to, if anything does: `fit: field/field.safetensors`.
    pub of: Option<String>,
    /// What was done about it.
    pub remedy: Remedy,
}

/// What is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "fault", rename_all = "snake_case")]
pub enum StoreFault {
    /// A blob of the right size has other bytes than its name says.
    Changed,
    /// A blob is shorter than it was.
    Truncated { bytes: u64, expected: u64 },
    /// A blob is longer than it was.
    Grown { bytes: u64, expected: u64 },
    /// A blob lies under another name than its own, which nothing has.
    Misnamed { blob: Digest },
    /// A file can be written that must not change.
    Writable,
    /// The system does not let it be read.
    Unreadable { problem: String },
    /// There is a folder, a link or a device where a file should be, or a file where a folder
    /// should be.
    WrongType { found: &'static str },
    /// It does not say what it should.
    Garbled { problem: String },
    /// It is about another key than that of its name.
    OtherKey { key: Digest },
    /// A result whose blob is gone or damaged.
    WithoutBlob { file: String },
    /// A result without the manifest of its key.
    WithoutManifest,
    /// A file shown under `out/` that is none of the store's.
    Shown,
    /// A blob that no result refers to: a stage was stopped while its result was kept.
    Orphan { bytes: u64 },
    /// The private folder of a stage that runs, or was interrupted.
    Interrupted,
    /// The lease of a process that computes a key, or was killed while it did.
    Lease,
    /// A file on its way, or on the way of a process that was killed.
    Temporary,
    /// Nothing of the program's.
    Stray,
}

/// What was done about a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Remedy {
    None,
    /// Moved to `quarantine/`.
    Quarantined,
    /// Made as it was.
    Mended,
}

impl StoreFault {
    /// Whether something is lost or wrong; what interrupted runs leave is neither.
    pub fn is_damage(&self) -> bool {
        !matches!(
            self,
            Self::Orphan { .. } | Self::Interrupted | Self::Lease | Self::Temporary | Self::Stray
        )
    }
}

impl fmt::Display for StoreFault {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Changed => f.write_str("its bytes have changed"),
            Self::Truncated { bytes, expected } => {
                write!(f, "cut short: {bytes} of {expected} bytes")
            }
            Self::Grown { bytes, expected } => {
                write!(f, "grown: {bytes} bytes instead of {expected}")
            }
            Self::Misnamed { blob } => write!(f, "it is the blob {}", short(blob)),
            Self::Writable => f.write_str("it can be written"),
            Self::Unreadable { problem } => write!(f, "it cannot be read: {problem}"),
            Self::WrongType { found } => write!(f, "there is a {found}"),
            Self::Garbled { problem } => write!(f, "garbled: {problem}"),
            Self::OtherKey { key } => write!(f, "it is about the key {}", short(key)),
            Self::WithoutBlob { file } => write!(f, "its blob is lost: {file}"),
            Self::WithoutManifest => f.write_str("its manifest is gone"),
            Self::Shown => f.write_str("it is not what the store has"),
            Self::Orphan { bytes } => write!(f, "no result refers to it ({bytes} bytes)"),
            Self::Interrupted => f.write_str("a stage that runs or was interrupted"),
            Self::Lease => f.write_str("a process that runs or was killed"),
            Self::Temporary => f.write_str("a file on its way"),
            Self::Stray => f.write_str("nothing of the store's"),
        }
    }
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(match self {
            Self::None => "left as it is",
            Self::Quarantined => "moved to quarantine",
            Self::Mended => "mended",
        })
    }
}

fn short(digest: &Digest) -> String {
    digest.to_string()[..12].to_owned()
}
