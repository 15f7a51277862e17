//! Poses for photos that have none: somebody's COLMAP finds them. Knows which of its commands to
//! run in which order, and no pipelines.
//!
//! All is made in one folder, which becomes a scene in COLMAP's layout: `images` and `sparse`.

mod error;
mod photos;
mod step;
mod tool;

use std::fs;
use std::path::{Path, PathBuf};

use scene::{Colmap, Registered};

pub use error::ImportError;
pub use step::{ImportProgress, Step};
pub use tool::{Places, Tool};

/// Of a video with more frames, only frames that follow one another are compared: the number of
/// pairs grows with the square.
const MOST_PAIRED_FRAMES: usize = 300;

/// What to find poses for, and how.
pub struct Import {
    /// A folder of photos, or a video.
    pub photos: PathBuf,
    /// The folder to make.
    pub folder: PathBuf,
    /// COLMAP's name of the lens model.
    pub lens: String,
    /// Frames of a video that are taken, for each second.
    pub rate: f64,
    /// The smallest part of the photos that must find a pose.
    pub least: f64,
}

/// What came out.
#[derive(Debug)]
pub struct Imported {
    /// How many photos there are.
    pub photos: usize,
    /// What the reconstruction has.
    pub registered: Registered,
}

impl Import {
    /// Makes the folder. It is called `FOLDER.part` until all is well. A failure leaves it, so that
    /// people can look into it; the next try removes it first.
    pub fn run(
        &self,
        tool: &Tool,
        progress: &mut dyn ImportProgress,
    ) -> Result<Imported, ImportError> {
        let work = self.work();
        remove(&work)?;
        fs::create_dir_all(&work).map_err(|error| ImportError::file(&work, error))?;
        let photos = photos::gather(self, &work, progress)?;
        let registered = self.reconstruct(tool, &work, &photos, progress)?;
        // The name appears when all is well, so that a folder of this name is always a whole scene.
        fs::rename(&work, &self.folder).map_err(|error| ImportError::file(&self.folder, error))?;
        Ok(Imported {
            photos: photos.count,
            registered,
        })
    }

    /// Where the folder is made.
    fn work(&self) -> PathBuf {
        let mut name = self.folder.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        // Beside the folder, and so on one file system: at the end it is renamed.
        self.folder.with_file_name(name)
    }

    fn reconstruct(
        &self,
        tool: &Tool,
        work: &Path,
        photos: &photos::Gathered,
        progress: &mut dyn ImportProgress,
    ) -> Result<Registered, ImportError> {
        let in_time = photos.is_video && photos.count > MOST_PAIRED_FRAMES;
        let lens = &self.lens;
        let one_lens = photos.one_size;
        let run = |step: Step, progress: &mut dyn ImportProgress| {
            tool.run(&step, work, photos.count, progress)
        };
        run(Step::Features { lens, one_lens }, progress)?;
        run(Step::Matches { in_time }, progress)?;
        // Of all mappers, for the message: the last one need not have found the most.
        let mut best = 0;
        // The global mapper is faster, but finds less where focal lengths are unknown.
        for global in tool.mappers() {
            // What an earlier mapper left would be taken for models of this one.
            remove(&work.join("sparse"))?;
            fs::create_dir(work.join("sparse")).map_err(|error| ImportError::file(work, error))?;
            run(Step::Poses { global: *global }, progress)?;
            // A mapper that finds nothing leaves no model. The next one may find some.
            let Ok(registered) = Colmap::registered(work) else {
                continue;
            };
            if registered.photos as f64 >= self.least * photos.count as f64 {
                return Ok(registered);
            }
            best = best.max(registered.photos);
        }
        Err(ImportError::TooFew {
            registered: best,
            photos: photos.count,
            log: step::log(work),
        })
    }
}

fn remove(folder: &Path) -> Result<(), ImportError> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(ImportError::file(folder, error))
        }
        _ => Ok(()),
    }
}
