//! What `transforms.json` says of a lens: once for all frames, or of one. Knows no photos.

use formats::Distortion;
use serde_json::{Map, Value};

use super::page::{kind, number};

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

/// Fields of a lens. They may stand in a frame or, for all frames, at the top; a frame's own win.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lens {
    /// Width and height.
    pub(crate) size: [Option<f64>; 2],
    pub(crate) focal: [Option<f64>; 2],
    /// Fields of view in radians.
    pub(crate) angles: [Option<f64>; 2],
    pub(crate) center: [Option<f64>; 2],
    /// Near and far.
    pub(crate) range: [Option<f64>; 2],
    /// k1 to k6, p1, p2.
    bent: [Option<f64>; 8],
    model: Option<String>,
    is_fisheye: Option<bool>,
}

impl Lens {
    /// Names of the fields.
    pub(crate) const FIELDS: [&str; 22] = [
        "w",
        "h",
        "fl_x",
        "fl_y",
        "camera_angle_x",
        "camera_angle_y",
        "x_fov",
        "y_fov",
        "cx",
        "cy",
        "near",
        "far",
        "k1",
        "k2",
        "k3",
        "k4",
        "k5",
        "k6",
        "p1",
        "p2",
        "camera_model",
        "is_fisheye",
    ];

    pub(crate) fn of(fields: &Map<String, Value>) -> Result<Self, String> {
        let pair = |x: &str, y: &str| Ok::<_, String>([number(fields, x)?, number(fields, y)?]);
        let degrees = |pair: [Option<f64>; 2]| pair.map(|angle| angle.map(f64::to_radians));
        let mut bent = [None; 8];
        for (slot, name) in bent
            .iter_mut()
            .zip(["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"])
        {
            *slot = number(fields, name)?;
        }
        let angles = pair("camera_angle_x", "camera_angle_y")?;
        let fov = degrees(pair("x_fov", "y_fov")?);
        Ok(Self {
            size: pair("w", "h")?,
            focal: pair("fl_x", "fl_y")?,
            angles: [0, 1].map(|axis| angles[axis].or(fov[axis])),
            center: pair("cx", "cy")?,
            range: pair("near", "far")?,
            bent,
            model: match fields.get("camera_model") {
                None | Some(Value::Null) => None,
                Some(Value::String(model)) => Some(model.to_uppercase()),
                Some(other) => {
                    return Err(format!("camera_model is {}; expected a name", kind(other)));
                }
            },
            is_fisheye: match fields.get("is_fisheye") {
                None | Some(Value::Null) => None,
                Some(Value::Bool(fisheye)) => Some(*fisheye),
                Some(other) => {
                    return Err(format!(
                        "is_fisheye is {}; expected true or false",
                        kind(other)
                    ));
                }
            },
        })
    }

    /// A frame's lens, with what it does not say itself taken from what all frames share.
    pub(crate) fn or(&self, shared: &Lens) -> Lens {
        // A frame with a focal length of its own wants no field of view from the top, nor the other
        // way round.
        let own_focal = self.focal[0].is_some() || self.angles[0].is_some();
        let (focal, angles) = match own_focal {
            true => (self.focal, self.angles),
            false => (either(self.focal, shared.focal), shared.angles),
        };
        Lens {
            size: either(self.size, shared.size),
            focal,
            angles,
            center: either(self.center, shared.center),
            range: either(self.range, shared.range),
            bent: either(self.bent, shared.bent),
            model: self.model.clone().or(shared.model.clone()),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
        }
    }

    /// Refuses lenses that are neither OpenCV's pinholes nor its fisheye.
    pub(crate) fn distortion(&self) -> Result<Distortion, String> {
        let numbers = self.bent.map(|coefficient| coefficient.unwrap_or(0.0));
        if numbers.iter().any(|number| !number.is_finite()) {
            return Err("a distortion coefficient is not finite".into());
        }
        let [k1, k2, k3, k4, k5, k6, p1, p2] = numbers;
        let model = self.model.as_deref();
        let fisheye = self.is_fisheye == Some(true) || model.is_some_and(|m| FISHEYES.contains(&m));
        let full = model == Some("FULL_OPENCV");
        let all_zero = |numbers: &[f64]| numbers.iter().all(|number| *number == 0.0);
        let known = fisheye || full || model.is_none_or(|m| PINHOLES.contains(&m));
        if !known {
            let model = model.unwrap_or_default();
            return Err(format!("camera_model is {model}; {SUPPORTED}"));
        }
        if fisheye && !all_zero(&[k5, k6, p1, p2]) {
            return Err(format!("a fisheye has k5, k6, p1 or p2; {SUPPORTED}"));
        }
        if !fisheye && !full && !all_zero(&[k4, k5, k6]) {
            return Err(format!(
                "k4, k5 or k6 is set, but camera_model is neither FULL_OPENCV nor a fisheye; {SUPPORTED}"
            ));
        }
        Ok(Distortion {
            k1,
            k2,
            k3,
            p1,
            p2,
            k4,
            k5,
            k6,
            fisheye,
        })
    }

    /// Focal lengths in pixels of an image of this size.
    pub(crate) fn focal(&self, size: [u32; 2]) -> Result<[f64; 2], String> {
        let by_angle = |axis: usize| {
            self.angles[axis].map(|angle| 0.5 * f64::from(size[axis]) / (0.5 * angle).tan())
        };
        let x = self.focal[0].or(by_angle(0));
        let x = x.ok_or("has neither fl_x nor camera_angle_x nor x_fov, nor has the whole file")?;
        // Pixels are square unless the file says otherwise.
        let y = match self.focal[0] {
            Some(_) => self.focal[1],
            None => self.focal[1].or(by_angle(1)),
        };
        Ok([x, y.unwrap_or(x)])
    }
}

const SUPPORTED: &str = "known are pinholes with OpenCV's k1 to k6, p1 and p2 and its fisheye with k1 to k4: undistort \
                         the photos first";

fn either<const N: usize>(own: [Option<f64>; N], shared: [Option<f64>; N]) -> [Option<f64>; N] {
    std::array::from_fn(|i| own[i].or(shared[i]))
}
