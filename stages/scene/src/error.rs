//! What can be wrong with a scene on disk, in words that name the file and say how to mend it.

use std::path::{Path, PathBuf};

/// Why a scene could not be read or made. Each message is whole: file, fault, remedy.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A folder or file that should be there is not.
    #[error("{path}: {expected} is missing; {remedy}", path = path.display())]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
        /// What should have been there.
        expected: &'static str,
        /// How the user can mend it.
        remedy: String,
    },
    /// The operating system could not read it.
    #[error("{path}: cannot be read: {source}", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file of poses, cameras or points with something in it that cannot be.
    #[error("{path}: {place}: {fault}", path = path.display())]
    Content {
        /// The file that holds it.
        path: PathBuf,
        /// Where in it: a field, a line, a record.
        place: String,
        /// What is there, and what was expected.
        fault: String,
    },
    /// A `.npy` file that is broken or holds something else than expected.
    #[error("{path}: {fault}; expected {expected}", path = path.display())]
    Npy {
        /// The `.npy` file.
        path: PathBuf,
        /// What is wrong with it, as its reader found it.
        fault: String,
        /// What a good file holds.
        expected: &'static str,
    },
    /// A camera that cannot be one: not a number, not a rotation, no focal length, near not before
    /// far.
    #[error("{path}, row {row} (counted from 0): {fault}; run the pose estimation again or leave this photo out", path = path.display())]
    Pose {
        /// The file that the camera is from.
        path: PathBuf,
        /// The number of the camera in it.
        row: usize,
        /// What is wrong with it.
        fault: String,
    },
    /// As many cameras as photos are needed.
    #[error("{folder} holds {images} images but {poses_file} has {poses} poses; they must be as many, in the same sorted order", folder = folder.display(), poses_file = poses_file.display())]
    Count {
        /// The folder of photos.
        folder: PathBuf,
        /// How many photos it holds.
        images: usize,
        /// The file of poses.
        poses_file: PathBuf,
        /// How many poses it holds.
        poses: usize,
    },
    /// A photo that cannot be decoded.
    #[error("{path}: not a readable photo: {fault}; copy it again, or convert it to {formats}", path = path.display(), formats = crate::photo_file::FORMATS)]
    Image {
        /// The photo that cannot be decoded.
        path: PathBuf,
        /// What the decoder said.
        fault: String,
    },
    /// Photos of one scene must have one size.
    #[error("{path} is {width}x{height} but {first} is {first_width}x{first_height}; all photos of a scene must have one size", path = path.display(), first = first.display(), width = size.0, height = size.1, first_width = first_size.0, first_height = first_size.1)]
    MixedSizes {
        /// The photo that differs.
        path: PathBuf,
        /// Its width and height.
        size: (u32, u32),
        /// The first photo, which the others have to match.
        first: PathBuf,
        /// Its width and height.
        first_size: (u32, u32),
    },
    /// A text that git-lfs left in a file's place.
    #[error("{path}: is a git-lfs pointer, the file itself was not fetched; run `git lfs pull` in its repository", path = path.display())]
    NotFetched {
        /// The file in whose place it lies.
        path: PathBuf,
    },
    /// A requested size or factor that leaves no pixels.
    #[error("{what}: a {width}x{height} image cannot be made; {remedy}", width = size.0, height = size.1)]
    EmptyImage {
        /// What was asked for.
        what: String,
        /// The size that would result.
        size: (u32, u32),
        /// How the user can mend it.
        remedy: &'static str,
    },
}

impl SceneError {
    pub(crate) fn content(path: &Path, place: impl Into<String>, fault: impl Into<String>) -> Self {
        Self::Content {
            path: path.into(),
            place: place.into(),
            fault: fault.into(),
        }
    }

    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.into(),
            source,
        }
    }

    pub(crate) fn image(path: &Path, fault: impl Into<String>) -> Self {
        Self::Image {
            path: path.into(),
            fault: fault.into(),
        }
    }

    pub(crate) fn not_fetched(path: &Path) -> Self {
        Self::NotFetched { path: path.into() }
    }

    /// A photo that is there, in a format that is not read.
    pub(crate) fn not_read(path: &Path, format: &str) -> Self {
        Self::image(path, format!("it is {format}, which is not read"))
    }
}
