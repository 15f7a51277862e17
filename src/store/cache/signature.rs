//! What tells that a file is as it was when it was last looked at, without reading it.

use std::fs::{self, Metadata};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// A file that changed less than this before it was read may change again without a sign of it:
/// clocks of file systems are coarse.
const RACY: Duration = Duration::from_secs(2);

/// What tells that a file or a folder is as it was: inode, size, and when its content and its inode
/// changed, in nanoseconds. Of a folder, that it has the same names, and each for the same file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Signature(u64, u64, i64, i64);

impl Signature {
    /// Of a file that is there; `None` where the system does not say enough.
    #[cfg(unix)]
    pub fn of(data: &Metadata) -> Option<Self> {
        use std::os::unix::fs::MetadataExt;
        let nanos =
            |seconds: i64, nanos: i64| seconds.checked_mul(1_000_000_000)?.checked_add(nanos);
        let modified = nanos(data.mtime(), data.mtime_nsec())?;
        let changed = nanos(data.ctime(), data.ctime_nsec())?;
        // Content can be changed and its time set back, as `touch` and `rsync` do. When the inode
        // changed nobody can set, and a file that was replaced has another inode.
        Some(Self(data.ino(), data.len(), modified, changed))
    }

    /// Of a file that is there; `None` where the system does not say enough.
    #[cfg(not(unix))]
    pub fn of(_: &Metadata) -> Option<Self> {
        None
    }

    /// Of the file at a path.
    pub fn at(path: &Path) -> Option<Self> {
        Self::of(&fs::metadata(path).ok()?)
    }

    /// Whether the file has the content that it had: a second name for it changes no more than when
    /// its inode changed.
    pub fn has_content_of(&self, before: &Self) -> bool {
        (self.0, self.1, self.2) == (before.0, before.1, before.2)
    }

    /// Whether the file was left alone for long enough before `now` that any change after it would
    /// show.
    pub fn is_settled(&self, now: SystemTime) -> bool {
        // A file from the future, by a clock that was set back, is not settled either: another
        // change could leave the same time.
        let now = now
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default()
            .saturating_sub(RACY)
            .as_nanos();
        i64::try_from(now).is_ok_and(|now| self.2 < now && self.3 < now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_changed_just_now_is_not_settled() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, "1").unwrap();
        let Some(signature) = Signature::at(&path) else {
            return;
        };
        assert!(!signature.is_settled(SystemTime::now()));
        assert!(signature.is_settled(SystemTime::now() + Duration::from_secs(3)));
        assert!(
            !signature.is_settled(SystemTime::now() - Duration::from_secs(3600)),
            "a clock that was set back"
        );
    }
}
