//! What tells a file from all others, whatever its name.

use std::fs;
use std::path::Path;

/// Whether what lies at a path is still what was seen there; links are not followed.
pub fn same_entry(path: &Path, seen: &fs::Metadata) -> bool {
    fs::symlink_metadata(path)
        .is_ok_and(|there| identity(&there) == identity(seen) && there.len() == seen.len())
}

/// Whether two paths lead to one file.
pub fn same_file(a: &Path, b: &Path) -> bool {
    let pair = (fs::metadata(a), fs::metadata(b));
    // Where the system tells no identities, `None` equals `None`: that must not make all files the
    // same.
    matches!(pair, (Ok(a), Ok(b)) if identity(&a).is_some() && identity(&a) == identity(&b))
}

/// What tells a file from all others, whatever its name; `None` where the system does not say.
#[cfg(unix)]
pub fn identity(data: &fs::Metadata) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    Some((data.dev(), data.ino()))
}

#[cfg(not(unix))]
pub fn identity(_: &fs::Metadata) -> Option<(u64, u64)> {
    None
}
