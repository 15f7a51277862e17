//! What earlier processes have found, and while it stands need not be found again. A cache and
//! nothing else: any of it may be lost.

pub(super) mod clock;
pub(super) mod index;
mod memo;
pub mod no_op;
pub mod signature;

use std::sync::Arc;

use super::files::Files;
use clock::Clock;
use index::Index;

/// The cache of a store.
pub struct Cache {
    files: Arc<Files>,
    pub(super) index: Index,
    pub(super) clock: Clock,
}

impl Cache {
    pub(super) fn new(files: Arc<Files>, clock: Clock) -> Self {
        let index = Index::new(files.root.join("index"));
        Self {
            files,
            index,
            clock,
        }
    }

    /// Keeps what was found for later processes.
    pub(super) fn keep(&self) {
        self.index
            // A cache that cannot be written costs time, and fails no run.
            .keep(|path, bytes| drop(self.files.put(path, bytes)));
    }
}
