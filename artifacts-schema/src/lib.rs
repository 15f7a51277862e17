//! What lies on disk: one file per artifact type, its codec and its semantic digest.
