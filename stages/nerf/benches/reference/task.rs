//! What a run trains on and is judged by: photos, the shape of the field, and settings from the
//! command line. Knows nothing of training.

use nerf::{FieldConfig, Space, SpaceKind, TrainOptions, TrainView};
use scene::{
    Llff, Photo, Reader, Reducer, SceneData, Transforms, downscale, object, split_holdout,
    still_life, write_transforms,
};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};
use std::error::Error;
use std::path::{Path, PathBuf};

/// Every so many photos one is held out, where the scene sets none aside.
const HOLDOUT: usize = 8;
/// Side and number of the photos of `object`, as NeRF-synthetic's at half their size.
const OBJECT: (u32, u32) = (400, 100);

/// The photos of a run, and how the field is trained on them.
pub struct Task {
    /// Photos to train on.
    pub train: Vec<Photo>,
    /// Held-out photos, before [`Task::background`] where they are transparent.
    pub test: Vec<Photo>,
    /// What is behind held-out photos: white for photos with alpha, as NeRF-synthetic has it, else
    /// black.
    pub background: [f32; 3],
    /// The space of the scene.
    pub space: Space,
    /// The shape of the field.
    pub config: FieldConfig,
    /// Options of this project's trainer; the reference takes over those that it has.
    pub options: TrainOptions,
    /// Steps after which the held-out views are looked at.
    pub marks: Vec<u32>,
}

impl Task {
    /// From a scene's name or folder and settings `field.NAME=VALUE`, `train.NAME=VALUE`,
    /// `width=PIXELS` (of photos from elsewhere), `looks=COUNT` (at the held-out views),
    /// `judges=COUNT` (the first so many of these only: the reference takes minutes for large ones)
    /// or `space=Auto|Box|Perspective`.
    pub fn new(mut arguments: impl Iterator<Item = String>) -> Result<Self, Box<dyn Error>> {
        let source = arguments.next().unwrap_or("still_life".into());
        let mut field = Map::new();
        let mut train = Map::new();
        let mut width = 252;
        let mut looks = 8;
        let mut judges = usize::MAX;
        let mut kind = SpaceKind::Auto;
        train.insert("steps".into(), 400.into());
        for argument in arguments {
            let (name, value) = argument
                .split_once('=')
                .ok_or("settings look like name=value")?;
            match (name.split_once('.'), name) {
                (Some(("field", name)), _) => _ = field.insert(name.into(), value.parse()?),
                (Some(("train", name)), _) => _ = train.insert(name.into(), value.parse()?),
                (_, "width") => width = value.parse()?,
                (_, "looks") => looks = value.parse()?,
                (_, "judges") => judges = value.parse()?,
                (_, "space") => kind = serde_json::from_value(value.into())?,
                _ => return Err(format!("no setting is called {name}").into()),
            }
        }
        let scene = read(&source, width)?;
        let config: FieldConfig = set(field)?;
        let options: TrainOptions = set(train)?;
        config.check()?;
        let (train, test) = match scene.test.is_empty() {
            true => split_holdout(scene.photos, HOLDOUT),
            false => (scene.photos, scene.test),
        };
        let background = if test.iter().any(|photo| photo.pixels.alpha.is_some()) {
            [1.0; 3]
        } else {
            [0.0; 3]
        };
        let test = test
            .into_iter()
            .take(judges)
            .map(|photo| before(photo, background))
            .collect();
        let marks = (1..=looks)
            // Squares: early steps change most, and looks at them show how fast.
            .map(|i| options.steps * i * i / (looks * looks))
            .collect();
        let bounds = scene.bounds.map(|corner| corner.map(|x| x as f32));
        let cameras: Vec<_> = train.iter().map(|photo: &Photo| &photo.camera).collect();
        let space =
            Space::of(kind, bounds, &cameras).ok_or("the cameras do not look the same way")?;
        Ok(Self {
            train,
            test,
            background,
            space,
            config,
            options,
            marks,
        })
    }

    /// The photos as training takes them.
    pub fn views(&self) -> Vec<TrainView> {
        let view = |photo: &Photo| TrainView {
            camera: photo.camera,
            pixels: photo.pixels.clone().into(),
            mask: None,
            weight: 1.0,
            supersample: 1,
        };
        self.train.iter().map(view).collect()
    }
}

/// Defaults with some values replaced.
fn set<T: Default + Serialize + DeserializeOwned>(
    values: Map<String, Value>,
) -> Result<T, serde_json::Error> {
    let mut all = serde_json::to_value(T::default())?;
    values
        .into_iter()
        .for_each(|(name, value)| all[name] = value);
    serde_json::from_value(all)
}

fn read(source: &str, width: u32) -> Result<SceneData, Box<dyn Error>> {
    let folder = Path::new(source);
    match source {
        "still_life" => {
            let mut scene = still_life(24, (256, 192), 2, 0);
            let small = |photo: &Photo| downscale(photo, 2, Reducer::Area);
            scene.photos = scene.photos.iter().map(small).collect::<Result<_, _>>()?;
            Ok(scene)
        }
        "object" => {
            let path = object_folder()?;
            let scene = Transforms {
                path,
                ..Default::default()
            };
            Ok(scene.read()?)
        }
        _ if folder.join("poses_bounds.npy").is_file() => {
            let scene = Llff {
                folder: folder.to_owned(),
                images: None,
                size: Some((width, width * 3 / 4)),
            };
            Ok(scene.read()?)
        }
        _ => {
            let scene = Transforms {
                path: folder.to_owned(),
                size: Some((width, width)),
                bounds: None,
                test_every: 8,
            };
            Ok(scene.read()?)
        }
    }
}

/// The procedural object in the layout of NeRF-synthetic, drawn when it is not there yet.
fn object_folder() -> Result<PathBuf, Box<dyn Error>> {
    let (side, views) = OBJECT;
    let parent = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let folder = parent.join(format!("object_{side}_{views}"));
    if !folder.is_dir() {
        let scene = object(views, (side, side), 2, 0);
        let fresh = tempfile::tempdir_in(parent)?;
        write_transforms(fresh.path(), &scene.photos, &scene.test, scene.bounds)?;
        // In place by one rename, so that a run that was killed leaves no half of it under this
        // name.
        std::fs::rename(fresh.keep(), &folder)?;
    }
    Ok(folder)
}

/// A photo composited, on encoded values.
fn before(mut photo: Photo, background: [f32; 3]) -> Photo {
    let Some(alpha) = photo.pixels.alpha.take() else {
        return photo;
    };
    for (rgb, alpha) in photo
        .pixels
        .rgb
        .as_chunks_mut::<3>()
        .0
        .iter_mut()
        .zip(alpha)
    {
        *rgb = std::array::from_fn(|c| alpha * rgb[c] + (1.0 - alpha) * background[c]);
    }
    photo
}
