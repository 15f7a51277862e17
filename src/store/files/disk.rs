//! The file operations that change a store, all in one place, so that a test can end the world
//! after any of them.
//!
//! Knows no layout. Reading goes past it.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

#[cfg(test)]
pub use fault::DiskFault;

/// A file system.
#[derive(Default)]
pub struct Disk {
    #[cfg(test)]
    fault: Option<DiskFault>,
}

impl Disk {
    /// A file system that will fail.
    #[cfg(test)]
    pub fn failing(fault: DiskFault) -> Self {
        Self { fault: Some(fault) }
    }

    /// Asks whether an operation may be done; `grows` if it takes room.
    #[cfg(test)]
    fn pass(&self, what: &str, path: &Path, grows: bool) -> io::Result<()> {
        self.fault
            .as_ref()
            .map_or(Ok(()), |fault| fault.pass(what, path, grows))
    }

    #[cfg(not(test))]
    #[allow(clippy::unused_self)]
    fn pass(&self, _: &str, _: &Path, _: bool) -> io::Result<()> {
        Ok(())
    }

    /// Makes a folder and those above it, as far as they are missing.
    pub fn create_folders(&self, folder: &Path) -> io::Result<()> {
        if folder.is_dir() {
            return Ok(());
        }
        self.pass("create", folder, true)?;
        fs::create_dir_all(folder)
    }

    /// A new flushed file with a name of its own in `folder`, readable by all whom the user's mask
    /// lets.
    pub fn stage(&self, folder: &Path, bytes: &[u8]) -> io::Result<PathBuf> {
        self.pass("stage", folder, true)?;
        let mut builder = tempfile::Builder::new();
        let (mut file, path) = readable_by_all(builder.disable_cleanup(true))
            .tempfile_in(folder)?
            .into_parts();
        // In two halves, so that the crash test can stop between them and leave a file cut short.
        let (begin, end) = bytes.split_at(bytes.len() / 2);
        // Whoever renames this file relies on its bytes being on disk: a rename can survive a loss
        // of power that the bytes do not.
        let written = file
            .write_all(begin)
            .and_then(|()| self.pass("write", &path, true))
            .and_then(|()| file.write_all(end))
            .and_then(|()| self.pass("flush", &path, true))
            .and_then(|()| file.sync_all());
        match written {
            Ok(()) => Ok(path.to_path_buf()),
            Err(error) => {
                // The first error is the one to report.
                let _ = self.remove_file(&path);
                Err(error)
            }
        }
    }

    /// Gives a file another name, in place of whatever had it.
    pub fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.pass("rename", from, false)?;
        fs::rename(from, to)
    }

    /// Gives a file another name, unless something has it.
    pub fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.pass("rename", from, false)?;
        // `fs::rename` replaces what is there. This refuses in one step, and removes the staged
        // file when it does.
        tempfile::TempPath::try_from_path(from)?
            .persist_noclobber(to)
            .map_err(|error| error.error)
    }

    /// A second name for a file. There is none on another file system, for a file that has too
    /// many, or for another user's: then a copy is made, one that shares its blocks if it can,
    /// under a name of its own until it is whole.
    pub fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.pass("link", to, true)?;
        match fs::hard_link(from, to) {
            // A copy could not succeed either where the disk is full or the file is gone, and would
            // hide which of the two it is.
            Err(error)
                if !matches!(
                    error.kind(),
                    io::ErrorKind::StorageFull | io::ErrorKind::NotFound
                ) =>
            {
                // A copy takes time. Under its own name it would look whole before it is.
                let half = to.with_extension("half");
                let copied =
                    reflink_copy::reflink_or_copy(from, &half).and_then(|_| fs::rename(&half, to));
                copied.inspect_err(|_| drop(fs::remove_file(&half)))
            }
            other => other,
        }
    }

    /// Removes a file, if there is one.
    pub fn remove_file(&self, path: &Path) -> io::Result<()> {
        self.pass("remove", path, false)?;
        absent_is_fine(fs::remove_file(path))
    }

    /// Removes a folder with all that is in it, if there is one.
    pub fn remove_folder(&self, folder: &Path) -> io::Result<()> {
        if !folder.exists() {
            return Ok(());
        }
        self.pass("remove", folder, false)?;
        absent_is_fine(fs::remove_dir_all(folder))
    }

    /// Makes a file's bytes, or a folder's names, survive a loss of power.
    pub fn flush(&self, path: &Path) -> io::Result<()> {
        self.pass("flush", path, false)?;
        // A folder is opened like a file for this. That is what makes the names in it last.
        File::open(path)?.sync_all()
    }

    /// Makes a file read-only.
    pub fn protect(&self, path: &Path) -> io::Result<()> {
        self.pass("protect", path, false)?;
        let mut permissions = fs::metadata(path)?.permissions();
        permissions.set_readonly(true);
        fs::set_permissions(path, permissions)
    }
}

fn absent_is_fine(done: io::Result<()>) -> io::Result<()> {
    match done {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}

/// Temporary files are private unless told otherwise, but stores are shared: only the user's own
/// mask shall count.
#[cfg(unix)]
fn readable_by_all<'a, 'p, 's>(
    builder: &'a mut tempfile::Builder<'p, 's>,
) -> &'a mut tempfile::Builder<'p, 's> {
    use std::os::unix::fs::PermissionsExt;
    builder.permissions(fs::Permissions::from_mode(0o666))
}

#[cfg(not(unix))]
fn readable_by_all<'a, 'p, 's>(
    builder: &'a mut tempfile::Builder<'p, 's>,
) -> &'a mut tempfile::Builder<'p, 's> {
    builder
}

#[cfg(test)]
mod fault {
    //! What goes wrong with a file system, and when.

    use std::io;
    use std::path::{Path, PathBuf};
    use std::sync::{Arc, Mutex};

    /// Lets a number of operations pass, and refuses the others.
    pub struct DiskFault {
        left: Mutex<usize>,
        kind: io::ErrorKind,
        /// Whether only operations that take room are refused.
        growing: bool,
        done: Arc<Mutex<Vec<(String, PathBuf)>>>,
    }

    impl DiskFault {
        fn new(after: usize, kind: io::ErrorKind, growing: bool) -> Self {
            Self {
                left: Mutex::new(after),
                kind,
                growing,
                done: Arc::default(),
            }
        }

        /// What was done, in order: the verb, and on what.
        pub fn done(&self) -> Arc<Mutex<Vec<(String, PathBuf)>>> {
            self.done.clone()
        }

        /// After so many operations the machine stops: nothing that is tried later happens.
        pub fn crash(after: usize) -> Self {
            Self::new(after, io::ErrorKind::Other, false)
        }

        /// After so many operations that take room the disk is full.
        pub fn full(after: usize) -> Self {
            Self::new(after, io::ErrorKind::StorageFull, true)
        }

        /// After so many operations nothing can be changed any more.
        pub fn read_only(after: usize) -> Self {
            Self::new(after, io::ErrorKind::ReadOnlyFilesystem, false)
        }

        pub(super) fn pass(&self, what: &str, path: &Path, grows: bool) -> io::Result<()> {
            let mut left = self.left.lock().unwrap();
            if grows || !self.growing {
                *left = left
                    .checked_sub(1)
                    .ok_or_else(|| io::Error::from(self.kind))?;
            }
            self.done
                .lock()
                .unwrap()
                .push((what.to_owned(), path.to_owned()));
            Ok(())
        }
    }
}
