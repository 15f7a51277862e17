//! The JSON of `transforms.json` and its kin, as instant-ngp, nerfstudio and NeRF-synthetic write it. Knows no photos.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::{Camera, Distortion, SceneError, pose, source_files};

/// More frames than any capture has.
const MOST_FRAMES: usize = 1 << 20;
/// Fields that say nothing about what a camera sees: not worth a word.
const QUIET: &[&str] = &[
    "sharpness",
    "rotation",
    "camera_label",
    "timestamp",
    "colmap_im_id",
    "srnerf",
];

/// Fields of a lens may stand in a frame or, for all frames, at the top; a frame's own win.
macro_rules! with_lens {
    ($(#[$about:meta])* struct $Name:ident { $($own:tt)* }) => {
        $(#[$about])*
        #[derive(Debug, Deserialize)]
        pub(crate) struct $Name {
            w: Option<f64>, h: Option<f64>,
            fl_x: Option<f64>, fl_y: Option<f64>, cx: Option<f64>, cy: Option<f64>,
            camera_angle_x: Option<f64>, camera_angle_y: Option<f64>,
            k1: Option<f64>, k2: Option<f64>, k3: Option<f64>, k4: Option<f64>, p1: Option<f64>, p2: Option<f64>,
            near: Option<f64>, far: Option<f64>,
            camera_model: Option<String>, is_fisheye: Option<bool>,
            /// What is not used.
            #[serde(flatten)]
            others: BTreeMap<String, IgnoredAny>,
            $($own)*
        }

        impl $Name {
            fn lens(&self) -> Lens<'_> {
                let Self { w, h, fl_x, fl_y, cx, cy, camera_angle_x, camera_angle_y, near, far, .. } = *self;
                let Self { k1, k2, k3, k4, p1, p2, is_fisheye, .. } = *self;
                let model = self.camera_model.as_deref();
                let angles = [camera_angle_x, camera_angle_y];
                Lens { size: [w, h], focal: [fl_x, fl_y], angles, center: [cx, cy], range: [near, far],
                    bent: [k1, k2, k3, k4, p1, p2], model, is_fisheye }
            }
        }
    };
}

with_lens! {
    /// The whole file.
    struct File {
        pub(crate) frames: Vec<Frame>,
        /// The scene box, where the file is one of ours.
        pub(crate) aabb: Option<[[f64; 3]; 2]>,
        /// The side of instant-ngp's cube, and how it brings coordinates there: p * scale + offset.
        pub(crate) aabb_scale: Option<f64>,
        pub(crate) scale: Option<f64>,
        pub(crate) offset: Option<[f64; 3]>,
        /// nerfstudio's splits, by `file_path`.
        #[serde(default)]
        pub(crate) train_filenames: Vec<String>,
        #[serde(default)]
        pub(crate) val_filenames: Vec<String>,
        #[serde(default)]
        pub(crate) test_filenames: Vec<String>,
    }
}

with_lens! {
    /// One photo.
    struct Frame {
        pub(crate) file_path: String,
        transform_matrix: Vec<[f64; 4]>,
    }
}

#[derive(Clone, Copy)]
struct Lens<'a> {
    size: [Option<f64>; 2],
    focal: [Option<f64>; 2],
    angles: [Option<f64>; 2],
    center: [Option<f64>; 2],
    range: [Option<f64>; 2],
    /// k1, k2, k3, k4, p1, p2.
    bent: [Option<f64>; 6],
    model: Option<&'a str>,
    is_fisheye: Option<bool>,
}

impl<'a> Lens<'a> {
    fn or(self, shared: Lens<'a>) -> Lens<'a> {
        fn each<const N: usize>(
            own: [Option<f64>; N],
            shared: [Option<f64>; N],
        ) -> [Option<f64>; N] {
            std::array::from_fn(|i| own[i].or(shared[i]))
        }
        // A frame with a focal length of its own wants no field of view from the top, nor the other way round.
        let own_focal = self.focal[0].is_some() || self.angles[0].is_some();
        let (focal, angles) = if own_focal {
            (self.focal, self.angles)
        } else {
            (each(self.focal, shared.focal), shared.angles)
        };
        Lens {
            size: each(self.size, shared.size),
            focal,
            angles,
            center: each(self.center, shared.center),
            range: each(self.range, shared.range),
            bent: each(self.bent, shared.bent),
            model: self.model.or(shared.model),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
        }
    }

    /// Refuses lenses that are not OpenCV's with five coefficients.
    fn distortion(&self) -> Result<Distortion, String> {
        match self.model {
            None
            | Some(
                "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "RADIAL" | "SIMPLE_RADIAL"
                | "PERSPECTIVE",
            ) => {}
            Some(other) => return Err(format!("camera_model is {other}; {SUPPORTED}")),
        }
        let [k1, k2, k3, k4, p1, p2] = self.bent.map(|coefficient| coefficient.unwrap_or(0.0));
        if self.is_fisheye == Some(true) || k4 != 0.0 {
            return Err(format!("is_fisheye or k4 is set; {SUPPORTED}"));
        }
        match [k1, k2, k3, p1, p2].iter().all(|k| k.is_finite()) {
            true => Ok(Distortion { k1, k2, k3, p1, p2 }),
            false => Err("a distortion coefficient is not finite".into()),
        }
    }

    /// Focal lengths in pixels of an image of this size.
    fn focal(&self, size: [u32; 2]) -> Result<[f64; 2], String> {
        let by_angle = |axis: usize| {
            self.angles[axis].map(|angle| 0.5 * f64::from(size[axis]) / (0.5 * angle).tan())
        };
        let x = self.focal[0]
            .or(by_angle(0))
            .ok_or("has neither fl_x nor camera_angle_x, nor has the whole file")?;
        // Pixels are square unless the file says otherwise.
        let y = if self.focal[0].is_some() {
            self.focal[1]
        } else {
            self.focal[1].or(by_angle(1))
        };
        Ok([x, y.unwrap_or(x)])
    }
}

const SUPPORTED: &str =
    "only pinholes with OpenCV's k1, k2, k3, p1 and p2 are known: undistort the photos first";

impl File {
    /// Reads a file. An error names its line and column.
    pub(crate) fn read(path: &Path) -> Result<File, SceneError> {
        let bytes = source_files::read_file(path)?;
        let file: File = serde_json::from_slice(&bytes).map_err(|error| {
            let place = format!("line {}, column {}", error.line(), error.column());
            let text = error.to_string();
            let fault = text.split(" at line ").next().unwrap_or(&text);
            SceneError::content(path, place, fault)
        })?;
        match file.frames.len() {
            0 => Err(SceneError::content(
                path,
                "frames",
                "is empty; expected one per photo",
            )),
            count if count > MOST_FRAMES => Err(SceneError::content(
                path,
                "frames",
                format!("are {count}, too many"),
            )),
            _ => Ok(file),
        }
    }

    /// The camera of a frame whose photo has this size, and whether the file says its near and far.
    pub(crate) fn camera(&self, frame: &Frame, size: (u32, u32)) -> Result<(Camera, bool), String> {
        let lens = frame.lens().or(self.lens());
        let [width, height] =
            [(0, size.0), (1, size.1)].map(|(axis, found)| whole(lens.size[axis], found));
        let (width, height) = (
            width.ok_or("w is not a whole number of pixels")?,
            height.ok_or("h is not one")?,
        );
        let [fl_x, fl_y] = lens.focal([width, height])?;
        let range = (lens.range[0], lens.range[1]);
        if let (Some(near), Some(far)) = range
            && !(near > 0.0 && near < far && far.is_finite())
        {
            return Err(format!("near {near} and far {far} are not 0 < near < far"));
        }
        let camera = Camera {
            width,
            height,
            fl_x,
            fl_y,
            cx: lens.center[0].unwrap_or(0.5 * f64::from(width)),
            cy: lens.center[1].unwrap_or(0.5 * f64::from(height)),
            distortion: lens.distortion()?,
            camera_to_world: pose::rigid(&frame.transform_matrix)
                .map_err(|fault| format!("transform_matrix {fault}"))?,
            near: range.0.unwrap_or(1.0),
            far: range.1.unwrap_or(2.0),
        };
        pose::check(&camera)?;
        Ok((camera, range.0.is_some() && range.1.is_some()))
    }

    /// Whether the lens is given by its field of view alone, as in NeRF-synthetic.
    pub(crate) fn has_field_of_view_alone(&self) -> bool {
        let focal = self.fl_x.is_some() || self.frames.iter().any(|frame| frame.fl_x.is_some());
        self.camera_angle_x.is_some() && !focal
    }

    /// Names of fields that are not used: of the file, and `frames.` of its frames.
    pub(crate) fn unused(&self) -> Vec<String> {
        let of_frames = self.frames.iter().flat_map(|frame| frame.others.keys());
        let own = self.others.keys().map(|name| (name, name.clone()));
        let mut unused: Vec<String> = own
            .chain(of_frames.map(|name| (name, format!("frames.{name}"))))
            .filter(|(name, _)| !QUIET.contains(&name.as_str()))
            .map(|(_, shown)| shown)
            .collect();
        unused.sort();
        unused.dedup();
        unused
    }
}

/// A count of pixels that files also write as `540.0`.
fn whole(stated: Option<f64>, found: u32) -> Option<u32> {
    let Some(stated) = stated else {
        return Some(found);
    };
    ((1.0..=65536.0).contains(&stated) && stated.fract() == 0.0).then_some(stated as u32)
}
