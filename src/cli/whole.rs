//! Files and folders that are written whole or not at all: beside their place first, then moved to
//! it. Knows nothing of what is in them.

use std::fmt::Display;
use std::io::Write;
use std::path::Path;

use super::error::Error;

/// Writes a file.
pub fn file(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), Error> {
    let written = beside(path).and_then(|file| {
        let mut out = std::io::BufWriter::new(file);
        write(&mut out)?;
        // `into_inner` writes what is still in the buffer and tells if that fails. Dropping it
        // would not.
        out.into_inner()?
            .persist(path)
            .map(drop)
            .map_err(|error| error.error)
    });
    written.map_err(|error| refused(path, &error))
}

/// Has another program write a file: it is given a path with the same ending.
pub fn by_another(
    path: &Path,
    write: impl FnOnce(&Path) -> Result<(), Error>,
) -> Result<(), Error> {
    // In the same folder, and so on the same file system: only there can it be renamed into place.
    let work = tempfile::tempdir_in(parent(path)).map_err(|error| refused(path, &error))?;
    let name = path.file_name().unwrap_or_default();
    let beside = work.path().join(name);
    write(&beside)?;
    std::fs::rename(&beside, path).map_err(|error| refused(path, &error))
}

/// Makes a folder, which must not be there yet.
pub fn folder<T>(path: &Path, write: impl FnOnce(&Path) -> Result<T, Error>) -> Result<T, Error> {
    if path.exists() {
        return Err(Error::usage(
            format!("{} is there already", path.display()),
            "choose another place",
        ));
    }
    let work = tempfile::tempdir_in(parent(path)).map_err(|error| refused(path, &error))?;
    // Inside of the temporary folder, which is private: a new folder has the rights that the user
    // gives to new ones.
    let beside = work.path().join("folder");
    let written = write(&beside)?;
    std::fs::rename(&beside, path).map_err(|error| refused(path, &error))?;
    Ok(written)
}

/// An empty file in the same folder, which others may read as far as the user lets them read new
/// files: temporary ones are for nobody else.
pub fn beside(path: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(parent(path))
}

/// The error for a place that cannot be written to.
pub fn refused(path: &Path, error: &dyn Display) -> Error {
    Error::usage(
        format!("cannot write {}: {error}", path.display()),
        "choose another place",
    )
}

fn parent(path: &Path) -> &Path {
    path.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}
