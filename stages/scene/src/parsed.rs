//! A scene whose files of poses were read: photos are decoded from here on, a few at a time. Knows
//! no format.

use std::path::{Path, PathBuf};

use formats::{Bounds, Camera};
use glam::DMat4;
use image::metadata::Orientation;
use rayon::prelude::*;

use crate::downscale::shrink_covered;
use crate::mask::{self, MaskFile};
use crate::photo_file::{self, Decoded};
use crate::{Photo, Reducer, SceneData, SceneError, source_files};

/// Bytes of memory that a photo takes for each of its pixels while it is decoded and resized.
const PIXEL: u64 = 48;
/// Bytes that photos may take at a time, unless one alone takes more.
const AT_A_TIME: u64 = 2 << 30;

/// A photo yet to be read, with its camera at the file's own size once it is turned.
#[derive(Clone, Debug)]
pub(crate) struct Posed {
    pub(crate) name: String,
    pub(crate) file: PathBuf,
    pub(crate) camera: Camera,
    /// How the file's rows are turned to be what the camera is for.
    pub(crate) turn: Orientation,
    pub(crate) mask: Option<MaskFile>,
}

/// A scene whose photos are not decoded yet.
#[derive(Clone, Debug)]
pub struct ParsedScene {
    /// Files of poses and points.
    pub(crate) sources: Vec<PathBuf>,
    pub(crate) train: Vec<Posed>,
    /// What the source itself sets aside for testing.
    pub(crate) test: Vec<Posed>,
    pub(crate) bounds: Bounds,
    /// Takes the scene's coordinates to those of the files.
    pub(crate) to_source: DMat4,
    /// The size asked for.
    pub(crate) size: Option<(u32, u32)>,
    pub(crate) description: String,
    pub(crate) notes: Vec<String>,
}

/// What notes say of photos that were decoded.
#[derive(Clone, Copy, Default)]
struct Facts {
    /// Photos whose values were cut off.
    clipped: usize,
    /// Photos with a mask, their pixels, and how many of these are masked.
    masks: usize,
    pixels: usize,
    masked: usize,
}

impl ParsedScene {
    /// How many photos there are to train on or to split, and how many the source itself sets aside
    /// for testing.
    pub fn counts(&self) -> (usize, usize) {
        (self.train.len(), self.test.len())
    }

    /// Width and height of each photo that is made of its file, by name: first those to train on or
    /// to split.
    pub fn sizes(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.file_sizes().map(|own| self.size.unwrap_or(own))
    }

    /// Width and height of each photo's file, once it is turned.
    pub fn file_sizes(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let photos = self.train.iter().chain(&self.test);
        photos.map(|posed| (posed.camera.width, posed.camera.height))
    }

    /// An axis-aligned box around all that the cameras see: [`SceneData::bounds`].
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// The similarity that takes the scene's coordinates to those of the files.
    pub fn to_source(&self) -> DMat4 {
        self.to_source
    }

    /// What was left out or had to be guessed, as far as that can be said before photos are
    /// decoded.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// A BLAKE3 digest over the names and bytes of all files.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn digest(&self) -> Result<[u8; 32], SceneError> {
        source_files::digest(self.files())
    }

    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        let photos = self.train.iter().chain(&self.test);
        let own = photos.flat_map(|posed| {
            let mask = posed.mask.as_ref().map(|mask| mask.path.as_path());
            std::iter::once(posed.file.as_path()).chain(mask)
        });
        self.sources.iter().map(PathBuf::as_path).chain(own)
    }

    /// Decodes all photos, a few at a time, and hands on what `ready` makes of each: those to train
    /// on or to split, numbered from 0 in the order of their names, and then those set aside.
    /// Returns all that is to be noted.
    ///
    /// # Errors
    /// The first photo in order that is damaged; what `ready` and `take` refuse.
    pub fn for_each<T: Send, E: From<SceneError>>(
        mut self,
        ready: impl Fn(usize, Photo) -> Result<T, SceneError> + Sync,
        mut take: impl FnMut(T) -> Result<(), E>,
    ) -> Result<Vec<String>, E> {
        // By name: the hold-out counts in that order, whatever the file's.
        self.train.sort_by(|a, b| a.name.cmp(&b.name));
        self.test.sort_by(|a, b| a.name.cmp(&b.name));
        let pixels = |(width, height): (u32, u32)| u64::from(width) * u64::from(height);
        // Resized photos may be larger than their files.
        let largest = self.file_sizes().chain(self.size).map(pixels).max();
        let group = at_a_time(largest.unwrap_or(0));
        let posed: Vec<(usize, &Posed)> = self.train.iter().chain(&self.test).enumerate().collect();
        let mut facts = Facts::default();
        for group in posed.chunks(group) {
            let read = |&(at, posed): &(usize, &Posed)| {
                let (photo, clipped) = read_photo(posed, self.size)?;
                let facts = Facts::of(&photo, clipped);
                Ok((ready(at, photo)?, facts))
            };
            // In parallel, and collected in order: threads change no bit, and no fault.
            let read: Vec<Result<_, SceneError>> = group.par_iter().map(read).collect();
            for read in read {
                let (photo, of_photo) = read?;
                facts.add(of_photo);
                take(photo)?;
            }
        }
        let mut notes = self.notes;
        notes.extend(facts.notes(posed.len()));
        Ok(notes)
    }

    /// All photos at once.
    pub(crate) fn read(self) -> Result<SceneData, SceneError> {
        let (train, _) = self.counts();
        let bounds = self.bounds;
        let to_source = self.to_source;
        let description = self.description.clone();
        let mut photos = Vec::new();
        let notes = self.for_each::<_, SceneError>(
            |_, photo| Ok(photo),
            |photo| {
                photos.push(photo);
                Ok(())
            },
        )?;
        Ok(SceneData {
            test: photos.split_off(train),
            photos,
            bounds,
            to_source,
            description,
            notes,
        })
    }
}

/// How many photos of at most so many pixels are decoded at a time.
fn at_a_time(pixels: u64) -> usize {
    let threads = rayon::current_num_threads() as u64;
    (AT_A_TIME / (PIXEL * pixels).max(1)).clamp(1, threads.max(1)) as usize
}

/// Bytes of memory at most while photos of at most so many pixels are decoded.
pub fn decoding_memory(pixels: u64) -> u64 {
    PIXEL * pixels * at_a_time(pixels) as u64
}

impl Facts {
    fn of(photo: &Photo, clipped: bool) -> Self {
        let masked = |mask: &Vec<bool>| mask.iter().filter(|counts| !**counts).count();
        let mask = photo.mask.as_ref();
        Self {
            clipped: usize::from(clipped),
            masks: usize::from(mask.is_some()),
            pixels: mask.map_or(0, Vec::len),
            masked: mask.map_or(0, masked),
        }
    }

    fn add(&mut self, other: Self) {
        self.clipped += other.clipped;
        self.masks += other.masks;
        self.pixels += other.pixels;
        self.masked += other.masked;
    }

    /// Sentences on these of so many photos.
    fn notes(&self, photos: usize) -> Vec<String> {
        let clipped = format!(
            "{} photos hold linear values above 1, which are cut off there: scale the exposure down if that matters",
            self.clipped
        );
        let masked = format!(
            "{} of {photos} photos are masked ({:.1} % of their pixels): what is masked is neither trained on nor measured",
            self.masks,
            100.0 * self.masked as f64 / self.pixels.max(1) as f64
        );
        [(self.clipped, clipped), (self.masks, masked)]
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(|(_, note)| note)
            .collect()
    }
}

/// A photo, and whether its values were cut off.
fn read_photo(posed: &Posed, size: Option<(u32, u32)>) -> Result<(Photo, bool), SceneError> {
    let Decoded {
        size: found,
        pixels,
        clipped,
    } = photo_file::read(&posed.file, posed.turn)?;
    let size = size.unwrap_or(found);
    // The whole image plane is scaled, so the view of the world stays the same.
    let camera = posed.camera.scaled(size.0, size.1);
    let own = posed
        .mask
        .as_ref()
        .map(|mask| mask.read(&camera, posed.turn))
        .transpose()?;
    // What either leaves out is out.
    let mask = match (own, mask::inside_rim(&camera)) {
        (Some(own), Some(rim)) => Some(own.iter().zip(rim).map(|(a, b)| *a && b).collect()),
        (own, rim) => own.or(rim),
    };
    let photo = Photo {
        name: posed.name.clone(),
        camera,
        pixels: shrink_covered(&pixels, found, size, Reducer::Bicubic),
        mask,
    };
    Ok((photo, clipped))
}
