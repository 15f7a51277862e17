//! What a page asks for: a camera, a size, and what to show of which field. Checks all of it; knows
//! nothing of how it is rendered.

use formats::Camera;
use serde::Deserialize;

use super::subject::Subject;

/// The longest side of a picture, in pixels.
const LONGEST: u32 = 4096;
/// The most pixels of a picture.
const MOST_PIXELS: u64 = 1 << 23;
/// The most fields that are shown side by side.
const MOST_PANES: usize = 2;
/// The most places of a path.
const MOST_STANDS: usize = 10_000;

/// One camera, and what to show of it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Look {
    /// Where the camera stands.
    pub stand: Stand,
    /// Pixels in a row of the picture; its rows follow from the camera.
    pub width: u32,
    /// What to show, each in a picture of its own.
    pub panes: Vec<Pane>,
    /// Whether the camera is on its way: then one picture is enough, and it has to be soon.
    pub moving: bool,
}

/// Where a camera stands, and whose lens it has.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Stand {
    /// Where a photo was taken, with all that is known of its camera.
    Photo(usize),
    /// Anywhere, with the lens of a photo.
    Free {
        /// The photo.
        like: usize,
        /// Rows of the camera-to-world matrix, but for the last.
        pose: [[f64; 4]; 3],
    },
}

/// A picture of a field.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pane {
    /// The number of the field.
    pub field: usize,
    pub show: Show,
}

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Show {
    /// The colours of the field before black, as `Render` has them.
    Color,
    /// How far what is seen is, along the view axis.
    Depth,
    /// How much of the light from behind is held back.
    Opacity,
    /// Which way what is seen faces.
    Normals,
}

/// A path to keep.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Path {
    /// Where the camera stands in each frame.
    pub stands: Vec<Stand>,
}

impl Look {
    /// The camera of the whole picture, if all that is asked for is there.
    ///
    /// # Errors
    /// What is wrong, in words.
    pub fn camera(&self, subject: &Subject) -> Result<Camera, String> {
        if self.panes.is_empty() || self.panes.len() > MOST_PANES {
            return Err(format!("there may be 1 to {MOST_PANES} panes"));
        }
        let fields = subject.fields.len();
        if let Some(pane) = self.panes.iter().find(|pane| pane.field >= fields) {
            return Err(format!(
                "there is no field {}: there are {fields}",
                pane.field
            ));
        }
        let camera = self.stand.camera(subject)?;
        // Requests are not trusted with sizes: one could ask for more pixels than there is memory.
        let [width, height] = sized(&camera, self.width)?;
        Ok(camera.scaled(width, height))
    }
}

/// The size of a camera's picture of so many pixels in a row.
fn sized(camera: &Camera, width: u32) -> Result<[u32; 2], String> {
    let ratio = f64::from(camera.height) / f64::from(camera.width);
    // As a float until it is checked: with a tall camera it can exceed 32 bits.
    let height = (f64::from(width) * ratio).round().max(1.0);
    let sides_fit = (1..=LONGEST).contains(&width) && height <= f64::from(LONGEST);
    if !sides_fit || u64::from(width) * height as u64 > MOST_PIXELS {
        return Err(format!(
            "a picture of {width}x{height} pixels is none, or too large: the most are {MOST_PIXELS}"
        ));
    }
    Ok([width, height as u32])
}

impl Stand {
    /// The camera that stands there, with the size of its photo.
    ///
    /// # Errors
    /// A photo that there is not, or a pose that is none.
    pub fn camera(&self, subject: &Subject) -> Result<Camera, String> {
        let of_photo = |number: usize| {
            let camera = subject.cameras.get(number);
            camera.ok_or_else(|| format!("there is no photo {number}"))
        };
        match self {
            Self::Photo(number) => of_photo(*number).copied(),
            Self::Free { like, pose } => Ok(Camera {
                // A matrix from outside: one that shears or mirrors is no camera's.
                camera_to_world: scene::rigid(pose).map_err(|fault| format!("the pose {fault}"))?,
                near: subject.range[0],
                far: subject.range[1],
                ..*of_photo(*like)?
            }),
        }
    }
}

impl Path {
    /// The cameras along the path.
    ///
    /// # Errors
    /// A path of no or too many places, or the first place where no camera can stand.
    pub fn cameras(&self, subject: &Subject) -> Result<Vec<Camera>, String> {
        let count = self.stands.len();
        if count == 0 || count > MOST_STANDS {
            return Err(format!(
                "a path of {count} places; expected 1 to {MOST_STANDS}"
            ));
        }
        self.stands
            .iter()
            .map(|stand| stand.camera(subject))
            .collect()
    }
}
