//! Names of numbered files, as compositors write them. Knows nothing of what is in them.

use std::path::{Path, PathBuf};

use super::error::Error;

/// Names of files that are numbered: `fly/fly.####.exr`.
pub struct Pattern {
    /// Where they lie.
    pub folder: PathBuf,
    before: String,
    digits: usize,
    after: String,
}

impl Pattern {
    /// What a path with a # for each digit means.
    pub fn of(path: &Path) -> Result<Self, Error> {
        let refuse = |problem: &str| {
            Error::usage(
                format!("{} {problem}", path.display()),
                "name files like fly/fly.####.exr: a folder of their own, a # for each digit, and .exr",
            )
        };
        let name = path.file_name().and_then(|name| name.to_str());
        let name = name.ok_or_else(|| refuse("names no files"))?;
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        // All frames come into place at once, as one folder that is renamed.
        let folder = folder.ok_or_else(|| refuse("has no folder of its own"))?;
        if !name.to_ascii_lowercase().ends_with(".exr") {
            return Err(refuse("does not end in .exr"));
        }
        let start = name
            .find('#')
            .ok_or_else(|| refuse("has no place for a number"))?;
        let digits = name[start..].chars().take_while(|c| *c == '#').count();
        let after = &name[start + digits..];
        if after.contains('#') {
            return Err(refuse("has two places for a number"));
        }
        Ok(Self {
            folder: folder.to_owned(),
            before: name[..start].to_owned(),
            digits,
            after: after.to_owned(),
        })
    }

    /// The name of the file of this number.
    pub fn file(&self, number: u64) -> String {
        format!(
            // A number with more digits than there are # is written in full: no frame replaces
            // another.
            "{}{number:0width$}{}",
            self.before,
            self.after,
            width = self.digits
        )
    }
}
