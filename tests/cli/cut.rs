//! Runs that are cut off: by a signal, as soon as they have written so many files.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use walkdir::{DirEntry, WalkDir};

use crate::space::{Said, Space, signal};

/// A file as it was written at some time: a checkpoint is written again and again.
type Written = (PathBuf, SystemTime);

/// Runs a command until it has written so many files under a folder, then sends it a signal. It may
/// end by itself before.
pub fn cut_after(
    files: usize,
    signal_name: &str,
    folder: &str,
    space: &Space,
    arguments: &[&str],
) -> Said {
    let folder = space.path(folder);
    let mut seen = written(&folder);
    let enough = seen.len() + files;
    let mut child = space.spawn(arguments);
    while child.try_wait().unwrap().is_none() {
        seen.extend(written(&folder));
        if seen.len() >= enough {
            signal(&child, signal_name);
            break;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Space::wait(child)
}

/// The files under a folder. Those that go away meanwhile are left out.
fn written(folder: &Path) -> BTreeSet<Written> {
    let entries = WalkDir::new(folder).into_iter().flatten();
    let files = entries.filter(|entry| entry.file_type().is_file());
    let at = |entry: DirEntry| {
        let time = entry.metadata().ok()?.modified().ok()?;
        Some((entry.into_path(), time))
    };
    files.filter_map(at).collect()
}
