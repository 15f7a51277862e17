//! What tests of readers share: cameras that are known, photos of one colour, and files with a bit
//! of damage.

use std::path::{Path, PathBuf};

use formats::{Camera, Distortion, Pixels};
use glam::DVec3;
use scene::{Colmap, Llff, Photo, Reader, SceneData, SceneError, Transforms};

/// Width and height of all photos.
pub const SIZE: (u32, u32) = (24, 18);

/// Cameras around a point, of one lens that bends.
pub fn known_cameras(bent: Distortion) -> Vec<Camera> {
    let target = DVec3::new(1.0, 2.0, -20.0);
    let positions = [
        DVec3::new(-2.0, 2.5, 1.0),
        DVec3::new(1.0, 1.5, 0.0),
        DVec3::new(4.0, 2.2, 0.5),
    ];
    let camera = |position| Camera {
        width: SIZE.0,
        height: SIZE.1,
        fl_x: 30.0,
        fl_y: 31.0,
        cx: 12.5,
        cy: 8.5,
        distortion: bent,
        camera_to_world: Camera::look_at(position, target),
        near: 10.0,
        far: 40.0,
    };
    positions.map(camera).to_vec()
}

/// A lens of the size that phones have.
pub const BENT: Distortion = Distortion {
    k1: 0.06,
    k2: -0.08,
    k3: 0.0,
    p1: -0.001,
    p2: 0.0002,
    k4: 0.0,
    k5: 0.0,
    k6: 0.0,
    fisheye: false,
};

/// The reader of a COLMAP scene.
pub fn colmap(folder: &Path, images: Option<&str>, size: Option<(u32, u32)>) -> Colmap {
    Colmap {
        folder: folder.to_owned(),
        images: images.map(str::to_owned),
        size,
    }
}

/// The reader of an LLFF scene.
pub fn llff(folder: &Path, images: Option<&str>, size: Option<(u32, u32)>) -> Llff {
    Llff {
        folder: folder.to_owned(),
        images: images.map(str::to_owned),
        size,
    }
}

/// Reads a scene in `transforms.json`.
pub fn transforms(path: &Path, options: &Transforms) -> Result<SceneData, SceneError> {
    let path = path.to_owned();
    Transforms {
        path,
        ..options.clone()
    }
    .read()
}

/// Photos with 8-bit values, as files hold them; `transparent` ones have a coverage of their own.
pub fn photos(cameras: &[Camera], transparent: bool) -> Vec<Photo> {
    let photo = |(i, camera): (usize, &Camera)| {
        let pixels = camera.width as usize * camera.height as usize;
        let value = |n: usize| ((n * 7 + i * 31) % 256) as f32 / 255.0;
        Photo {
            name: format!("photo{i}"),
            camera: *camera,
            pixels: Pixels::new(
                (0..3 * pixels).map(value).collect(),
                transparent.then(|| (0..pixels).map(|n| value(n + 5)).collect()),
            ),
            mask: None,
        }
    };
    cameras.iter().enumerate().map(photo).collect()
}

/// Writes a photo of one colour.
pub fn write_photo(path: &Path, (width, height): (u32, u32), red: u8) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::RgbImage::from_pixel(width, height, image::Rgb([red, 10, 20]))
        .save(path)
        .unwrap();
}

/// The error's words, with the scene's folder left out.
pub fn words(error: SceneError, folder: &Path) -> String {
    error
        .to_string()
        .replace(&format!("{}", folder.display()), "SCENE")
}

/// What is wrong with bytes: cut off, overwritten, or with something between them.
#[derive(Clone, Debug)]
pub enum Damage {
    Cut(proptest::sample::Index),
    Overwrite(proptest::sample::Index, Vec<u8>),
    Insert(proptest::sample::Index, Vec<u8>),
}

impl Damage {
    pub fn to(&self, bytes: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        match self {
            Damage::Cut(at) => bytes.truncate(at.index(bytes.len().max(1))),
            Damage::Overwrite(at, with) => {
                let at = at.index(bytes.len().max(1));
                bytes
                    .iter_mut()
                    .skip(at)
                    .zip(with)
                    .for_each(|(byte, new)| *byte = *new);
            }
            Damage::Insert(at, what) => {
                let at = at.index(bytes.len().max(1));
                bytes.splice(at..at, what.iter().copied());
            }
        }
        bytes
    }
}

/// Any damage. Full bytes are likely: they make counts and numbers that nothing backs.
pub fn any_damage() -> impl proptest::strategy::Strategy<Value = Damage> {
    use proptest::prelude::*;
    let bytes = || prop::collection::vec(prop_oneof![any::<u8>(), Just(255), b'0'..=b'9'], 1..9);
    prop_oneof![
        any::<prop::sample::Index>().prop_map(Damage::Cut),
        (any::<prop::sample::Index>(), bytes())
            .prop_map(|(at, bytes)| Damage::Overwrite(at, bytes)),
        (any::<prop::sample::Index>(), bytes()).prop_map(|(at, bytes)| Damage::Insert(at, bytes)),
    ]
}

/// A folder of test data, if there are any on this machine.
pub fn real(name: &str) -> Option<PathBuf> {
    let data = std::env::var_os("SRNERF_TEST_DATA").map(|data| Path::new(&data).join(name));
    if data.is_none() {
        eprintln!("SRNERF_TEST_DATA is not set: {name} is skipped");
    }
    data
}
