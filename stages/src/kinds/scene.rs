//! `Scene`: reads or draws posed photos, reduces them and holds some out. Knows nothing of fields.

pub mod origin;

use std::path::PathBuf;

use artifacts_schema::{Digest, ImageSet};
use formats::rows;
use glam::DMat4;
use scene::{Photo, Reducer, SceneData};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::origin::{Origin, WORLDS};
use crate::convert;
use crate::error::StageError;
use crate::files;
use crate::io::Io;
use crate::port::{InputPort, OutputPort, Port};
use crate::stage::{Source, Stage};

const TRAIN: Port<ImageSet> = Port::new("train");
const TEST: Port<ImageSet> = Port::new("test");
const TEST_LOW: Port<ImageSet> = Port::new("test_low");

/// Posed photos: low-resolution ones to train on, and held-out ones at both resolutions.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Scene {
    /// Where the photos come from.
    pub source: Origin,
    /// Size of the full-resolution photos over the size of the low-resolution ones.
    #[schemars(range(min = 1, max = 64))]
    pub downscale: u32,
    /// The filter that makes the low-resolution photos.
    pub filter: Reducer,
    /// Every so many photos, in the order of their names, one is held out: numbers 0, 8, 16 …
    /// for 8. A source that sets photos aside by itself has the last word.
    #[schemars(range(min = 2, max = 1_000_000))]
    pub holdout: u32,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            source: Origin::default(),
            downscale: 4,
            filter: Reducer::Bicubic,
            holdout: 8,
        }
    }
}

impl Scene {
    fn read(&self, seed: u64) -> Result<SceneData, StageError> {
        if let Some(reader) = self.source.reader() {
            return Ok(reader.read()?);
        }
        let Origin::Procedural {
            world,
            views,
            size,
            samples,
        } = &self.source
        else {
            return Err(StageError::Mismatch("the source has no reader".into()));
        };
        let draw = match world.as_str() {
            "object" => scene::object,
            _ => scene::still_life,
        };
        Ok(draw(*views, *size, *samples, seed))
    }

    /// Refuses a source that leaves nothing to train on or nothing to hold out.
    fn check_counts(&self, train: usize, test: usize) -> Result<(), StageError> {
        let every = self.holdout as usize;
        let held_out = match test {
            // Numbers 0, 8, 16.. are held out: an incomplete row begins with one as well.
            0 => train.div_ceil(every),
            _ => test,
        };
        let trained = match test {
            0 => train - held_out,
            _ => train,
        };
        match trained == 0 || held_out == 0 {
            true => Err(StageError::Mismatch(format!(
                "the scene has {train} photos, too few to hold any out and train on the others"
            ))),
            false => Ok(()),
        }
    }

    fn reduce(&self, photos: &[Photo]) -> Result<Vec<Photo>, StageError> {
        Ok(photos
            .iter()
            .map(|photo| scene::downscale(photo, self.downscale, self.filter))
            .collect::<Result<_, _>>()?)
    }
}

impl Stage for Scene {
    fn kind(&self) -> &'static str {
        "Scene"
    }

    fn version(&self) -> u32 {
        3
    }

    fn check(&self) -> Result<(), StageError> {
        convert::in_range("downscale", self.downscale, 1, 64)?;
        convert::in_range("holdout", self.holdout, 2, 1_000_000)?;
        let size = match &self.source {
            Origin::Procedural {
                world,
                views,
                samples,
                size,
            } => {
                if !WORLDS.contains(&world.as_str()) {
                    let problem = format!("is `{world}`; the worlds are: {}", WORLDS.join(", "));
                    return Err(StageError::parameter("source.world", problem));
                }
                convert::in_range("source.views", *views, 2, 10_000)?;
                convert::in_range("source.samples", *samples, 1, 64)?;
                Some(*size)
            }
            Origin::Transforms {
                test_every, size, ..
            } => {
                convert::in_range("source.test_every", *test_every, 1, 1_000_000)?;
                *size
            }
            Origin::Llff { size, .. } | Origin::Colmap { size, .. } => *size,
        };
        let Some((w, h)) = size else { return Ok(()) };
        // At least eight low-resolution pixels a side.
        convert::in_range("source.size", w.min(h), self.downscale * 8, 16384)?;
        convert::in_range("source.size", w.max(h), self.downscale * 8, 16384)
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        Vec::new()
    }

    fn outputs(&self) -> Vec<OutputPort> {
        [TRAIN, TEST, TEST_LOW].map(Port::output).to_vec()
    }

    fn sources(&self) -> Result<Vec<Source>, StageError> {
        let Some(reader) = self.source.reader() else {
            return Ok(Vec::new());
        };
        let parsed = reader.parse()?;
        let (train, test) = parsed.counts();
        self.check_counts(train, test)?;
        let digest = parsed.digest()?;
        Ok(vec![Source {
            name: "photos and poses".into(),
            digest: Digest::new(digest),
        }])
    }

    fn source_files(&self) -> Option<Vec<PathBuf>> {
        match &self.source {
            Origin::Procedural { .. } => Some(Vec::new()),
            // Which photos a `transforms.json` names, and where they lie, only reading it tells.
            Origin::Transforms { .. } => None,
            // Another folder of photos may lie beside that of the poses.
            Origin::Llff { path, images, .. } | Origin::Colmap { path, images, .. } => {
                let photos = images
                    .as_ref()
                    .map_or(Some(Vec::new()), |images| files::tree(&path.join(images)))?;
                Some([files::tree(path)?, photos].concat())
            }
        }
    }

    fn locations(&self) -> &'static [&'static str] {
        &["source.path", "source.images"]
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        // Only drawn worlds make use of the seed.
        let data = self.read(io.seed)?;
        io.progress(1, 2, &[])?;
        data.notes.iter().for_each(|note| io.remark(note));
        // Here too, since a drawn world is not parsed.
        self.check_counts(data.photos.len(), data.test.len())?;
        let bounds = data.bounds;
        let (train, test) = match data.test.is_empty() {
            true => scene::split_holdout(data.photos, self.holdout as usize),
            false => (data.photos, data.test),
        };
        let to_source = match data.to_source == DMat4::IDENTITY {
            // Without it readers know that the scene's coordinates are the source's.
            true => None,
            false => Some(rows::of(&data.to_source)),
        };
        let set = |photos: &[Photo]| ImageSet {
            views: photos.iter().map(convert::photo_view).collect(),
            bounds,
            to_source,
        };
        io.write(TRAIN, &set(&self.reduce(&train)?))?;
        io.write(TEST, &set(&test))?;
        io.write(TEST_LOW, &set(&self.reduce(&test)?))?;
        io.progress(2, 2, &[])
    }
}
