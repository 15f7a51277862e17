//! What `transforms.json` says of a lens: once for all frames, or of one. Knows no photos.

use formats::json::kind;
use formats::{Distortion, Lens};
use serde_json::{Map, Value};

use super::page::number;

/// Models that are pinholes with OpenCV's k1, k2, k3, p1 and p2, or fewer of them.
const PINHOLES: [&str; 6] = [
    "OPENCV",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "RADIAL",
    "SIMPLE_RADIAL",
    "PERSPECTIVE",
];
/// Models that are OpenCV's fisheye, or less than it.
const FISHEYES: [&str; 4] = [
    "OPENCV_FISHEYE",
    "FISHEYE",
    "RADIAL_FISHEYE",
    "SIMPLE_RADIAL_FISHEYE",
];

/// What a file says of a lens, also in fields that ours have not. They may stand in a frame or, for
/// all frames, at the top; a frame's own win.
#[derive(Clone, Debug, Default)]
pub(crate) struct ForeignLens {
    pub(crate) lens: Lens,
    /// Fields of view in radians.
    pub(crate) angles: [Option<f64>; 2],
    model: Option<String>,
}

impl ForeignLens {
    /// Names of the fields, beside those of [`Lens`].
    const FIELDS: [&str; 5] = [
        "camera_angle_x",
        "camera_angle_y",
        "x_fov",
        "y_fov",
        "camera_model",
    ];

    /// Names of all fields.
    pub(crate) fn fields() -> Vec<&'static str> {
        [&Lens::FIELDS[..], &Self::FIELDS].concat()
    }

    pub(crate) fn of(fields: &Map<String, Value>) -> Result<Self, String> {
        let pair = |x: &str, y: &str| Ok::<_, String>([number(fields, x)?, number(fields, y)?]);
        let angles = pair("camera_angle_x", "camera_angle_y")?;
        let fov = pair("x_fov", "y_fov")?.map(|angle| angle.map(f64::to_radians));
        let lens = serde_path_to_error::deserialize(fields);
        Ok(Self {
            lens: lens.map_err(|error| format!("{} {}", error.path(), error.inner()))?,
            // Radians first: `x_fov`, in degrees, comes from other exporters.
            angles: [0, 1].map(|axis| angles[axis].or(fov[axis])),
            model: match fields.get("camera_model") {
                None | Some(Value::Null) => None,
                Some(Value::String(model)) => Some(model.to_uppercase()),
                Some(other) => {
                    return Err(format!("camera_model is {}; expected a name", kind(other)));
                }
            },
        })
    }

    /// A frame's lens, with what it does not say itself taken from what all frames share.
    pub(crate) fn or(&self, shared: &Self) -> Self {
        let lens = self.lens.or(&shared.lens);
        let model = self.model.clone().or(shared.model.clone());
        // A frame with a focal length of its own wants no field of view from the top, nor the other
        // way round.
        if self.lens.fl_x.is_some() || self.angles[0].is_some() {
            let Lens { fl_x, fl_y, .. } = self.lens;
            return Self {
                lens: Lens { fl_x, fl_y, ..lens },
                angles: self.angles,
                model,
            };
        }
        Self {
            lens,
            angles: shared.angles,
            model,
        }
    }

    /// Refuses lenses that are neither OpenCV's pinholes nor its fisheye.
    pub(crate) fn distortion(&self) -> Result<Distortion, String> {
        let distortion = self.lens.distortion();
        // A coefficient that is not finite would give every pixel a ray of NaN.
        if distortion
            .coefficients()
            .iter()
            .any(|number| !number.is_finite())
        {
            return Err("a distortion coefficient is not finite".into());
        }
        let Distortion {
            p1, p2, k4, k5, k6, ..
        } = distortion;
        let model = self.model.as_deref();
        let fisheye = distortion.fisheye || model.is_some_and(|m| FISHEYES.contains(&m));
        let full = model == Some("FULL_OPENCV");
        // Zeros are common: exporters write all coefficients whatever the model.
        let all_zero = |numbers: &[f64]| numbers.iter().all(|number| *number == 0.0);
        let known = fisheye || full || model.is_none_or(|m| PINHOLES.contains(&m));
        if !known {
            let model = model.unwrap_or_default();
            return Err(format!("camera_model is {model}; {SUPPORTED}"));
        }
        // The fisheye has k1 to k4 only; others would be dropped in silence.
        if fisheye && !all_zero(&[k5, k6, p1, p2]) {
            return Err(format!("a fisheye has k5, k6, p1 or p2; {SUPPORTED}"));
        }
        if !fisheye && !full && !all_zero(&[k4, k5, k6]) {
            return Err(format!(
                "k4, k5 or k6 is set, but camera_model is neither FULL_OPENCV nor a fisheye; {SUPPORTED}"
            ));
        }
        Ok(Distortion {
            fisheye,
            ..distortion
        })
    }

    /// Focal lengths in pixels of an image of this size.
    pub(crate) fn focal(&self, size: [u32; 2]) -> Result<[f64; 2], String> {
        // The pinhole's: fl = (size / 2) / tan(angle / 2).
        let by_angle = |axis: usize| {
            self.angles[axis].map(|angle| 0.5 * f64::from(size[axis]) / (0.5 * angle).tan())
        };
        let x = self.lens.fl_x.or(by_angle(0));
        let x = x.ok_or("has neither fl_x nor camera_angle_x nor x_fov, nor has the whole file")?;
        // Pixels are square unless the file says otherwise.
        let y = match self.lens.fl_x {
            Some(_) => self.lens.fl_y,
            None => self.lens.fl_y.or(by_angle(1)),
        };
        Ok([x, y.unwrap_or(x)])
    }
}

const SUPPORTED: &str = "known are pinholes with OpenCV's k1 to k6, p1 and p2 and its fisheye with k1 to k4: undistort \
                         the photos first";
