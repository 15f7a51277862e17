//! Where photos come from: a drawn world, or a folder in one of the layouts that are read. Reads
//! nothing itself; `scene` does.

use std::path::{Path, PathBuf};

use formats::Bounds;
use scene::{Colmap, Llff, Reader, Transforms};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where photos come from.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub enum Origin {
    /// A world that the program draws itself, so that the full-resolution truth is known.
    Procedural {
        /// Its name: `still_life`, or `object` (on a transparent background, seen from all around).
        #[serde(default = "still_life")]
        world: String,
        /// How many cameras.
        #[serde(default = "default_views")]
        #[schemars(range(min = 2, max = 10_000))]
        views: u32,
        /// Width and height of the full-resolution photos.
        #[serde(default = "default_size")]
        size: (u32, u32),
        /// Rays per pixel and axis.
        #[serde(default = "default_samples")]
        #[schemars(range(min = 1, max = 64))]
        samples: u32,
    },
    /// Cameras in `transforms.json`, or in `transforms_train.json` and `transforms_test.json`:
    /// NeRF-synthetic, instant-ngp, nerfstudio.
    Transforms {
        /// The folder, or the file itself.
        path: PathBuf,
        /// Width and height of the full-resolution photos; by default those of the files.
        #[serde(default)]
        size: Option<(u32, u32)>,
        /// The scene box in the file's coordinates; by default what the file says, or
        /// instant-ngp's.
        #[serde(default)]
        bounds: Option<Bounds>,
        /// Only every so many of the photos that the source sets aside for testing.
        #[serde(default = "one")]
        #[schemars(range(min = 1, max = 1_000_000))]
        test_every: u32,
    },
    /// A folder with a COLMAP reconstruction, `sparse/0`, beside a folder of images.
    Colmap {
        /// The folder.
        path: PathBuf,
        /// The images' folder inside it; by default the smallest that has the size asked for.
        #[serde(default)]
        images: Option<String>,
        /// Width and height of the full-resolution photos; by default those of the files.
        #[serde(default)]
        size: Option<(u32, u32)>,
    },
    /// A folder in the LLFF layout: `poses_bounds.npy` beside a folder of images.
    Llff {
        /// The folder.
        path: PathBuf,
        /// The images' folder inside it (`images_4`); by default the smallest that has the size
        /// asked for.
        #[serde(default)]
        images: Option<String>,
        /// Width and height of the full-resolution photos; by default those of the files.
        #[serde(default)]
        size: Option<(u32, u32)>,
    },
}

/// The worlds that can be drawn.
pub const WORLDS: &[&str] = &["still_life", "object"];

fn still_life() -> String {
    WORLDS[0].into()
}

fn one() -> u32 {
    1
}

fn default_views() -> u32 {
    24
}

fn default_size() -> (u32, u32) {
    (256, 192)
}

fn default_samples() -> u32 {
    4
}

impl Default for Origin {
    fn default() -> Self {
        Self::Procedural {
            world: still_life(),
            views: default_views(),
            size: default_size(),
            samples: default_samples(),
        }
    }
}

impl Origin {
    /// The reader of what lies on disk; `None` for a world that is drawn. A reader is no variant of
    /// `Origin` itself: names of parameters are in keys, and a library may rename its fields.
    pub fn reader(&self) -> Option<Box<dyn Reader>> {
        match self {
            Origin::Procedural { .. } => None,
            Origin::Llff { path, images, size } => Some(Box::new(Llff {
                folder: path.clone(),
                images: images.clone(),
                size: *size,
            })),
            Origin::Colmap { path, images, size } => Some(Box::new(Colmap {
                folder: path.clone(),
                images: images.clone(),
                size: *size,
            })),
            Origin::Transforms {
                path,
                size,
                bounds,
                test_every,
            } => Some(Box::new(Transforms {
                path: path.clone(),
                size: *size,
                bounds: *bounds,
                test_every: *test_every,
            })),
        }
    }

    /// The layout of what lies at `path`, by the names of its files; `None` if it is none of those
    /// that are read. Of several, the one that says most about the scene.
    pub fn at(path: &Path) -> Option<Self> {
        let has = |names: &[&str]| names.iter().any(|name| path.join(name).exists());
        let path = path.to_owned();
        // `Transforms` takes a file's path, too, and any name will do for it.
        let is_file = path
            .extension()
            .is_some_and(|end| end.eq_ignore_ascii_case("json"));
        if is_file || has(&["transforms.json", "transforms_train.json"]) {
            Some(Self::Transforms {
                path,
                size: None,
                bounds: None,
                test_every: one(),
            })
        } else if has(&["poses_bounds.npy"]) {
            // LLFF's scenes hold a COLMAP model too; their own file has near and far.
            Some(Self::Llff {
                path,
                images: None,
                size: None,
            })
        } else if Colmap::is_in(&path) {
            Some(Self::Colmap {
                path,
                images: None,
                size: None,
            })
        } else {
            None
        }
    }
}
