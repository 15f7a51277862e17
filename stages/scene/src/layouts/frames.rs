//! `transforms.json` as nerfstudio, brush and instant-ngp read it. Knows no pictures.
//!
//! Fields of ours that those programs pass over (`aabb` of the box, `near` and `far`) let our own
//! reader read the same scene.

use formats::rows;
use serde_json::{Map, Value, json};

use super::shot::{Masks, Shot};
use super::{Capture, Layout, LayoutError, lens};

/// The files, by their paths in the scene's folder.
pub(super) fn files(
    layout: Layout,
    shots: &[Shot],
    capture: &Capture,
    masks: Option<Masks>,
) -> Result<Vec<(&'static str, String)>, LayoutError> {
    let [train, test]: [Vec<&Shot>; 2] =
        [false, true].map(|is_test| shots.iter().filter(|s| s.is_test == is_test).collect());
    let writer = Writer {
        layout,
        capture,
        masks,
    };
    let files = match layout {
        Layout::Nerfstudio => {
            let all: Vec<&Shot> = shots.iter().collect();
            let mut page = writer.page(&all, "")?;
            if !test.is_empty() {
                let paths = |shots: &[&Shot]| shots.iter().map(|s| s.path()).collect::<Vec<_>>();
                page.insert("train_filenames".into(), json!(paths(&train)));
                // While it trains, nerfstudio measures on the list for validation.
                page.insert("val_filenames".into(), json!(paths(&test)));
                page.insert("test_filenames".into(), json!(paths(&test)));
            }
            vec![("transforms.json", page)]
        }
        Layout::Brush => {
            let mut files = vec![("transforms_train.json", writer.page(&train, "")?)];
            if !test.is_empty() {
                files.push(("transforms_test.json", writer.page(&test, "")?));
            }
            files
        }
        // Only instant-ngp comes here: COLMAP's layout has files of its own.
        _ => {
            let mut files = vec![("transforms.json", writer.page(&train, "")?)];
            if !test.is_empty() {
                // It trains on every JSON file of the folder that it is given.
                files.push(("test/transforms.json", writer.page(&test, "../")?));
            }
            files
        }
    };
    let text = |page: Map<String, Value>| format!("{:#}\n", Value::Object(page));
    Ok(files
        .into_iter()
        .map(|(name, page)| (name, text(page)))
        .collect())
}

struct Writer<'w> {
    layout: Layout,
    capture: &'w Capture<'w>,
    masks: Option<Masks>,
}

impl Writer<'_> {
    /// The page of some photos, whose paths begin with `up`.
    fn page(&self, shots: &[&Shot], up: &str) -> Result<Map<String, Value>, LayoutError> {
        let lenses = shots.iter().map(|shot| &shot.photo.camera);
        let lenses: Vec<Map<String, Value>> = lenses
            .map(|camera| lens::fields(self.layout, camera))
            .collect::<Result<_, _>>()?;
        let shared = lenses
            .first()
            .filter(|first| lenses.iter().all(|l| l == *first));
        let mut page = shared.cloned().unwrap_or_default();
        if shared.is_none() && self.layout == Layout::Nerfstudio {
            page.insert("camera_model".into(), one_model(&lenses)?);
        }
        let mut frames = Vec::new();
        for (shot, lens) in shots.iter().zip(&lenses) {
            let own = if shared.is_some() {
                Map::new()
            } else {
                lens.clone()
            };
            frames.push(self.frame(shot, own, up));
        }
        page.insert("frames".into(), Value::Array(frames));
        // Ours: other programs pass over it, and our reader gets the box back.
        page.insert("aabb".into(), json!(self.capture.bounds));
        self.place(&mut page);
        Ok(page)
    }

    fn frame(&self, shot: &Shot, mut frame: Map<String, Value>, up: &str) -> Value {
        let camera = &shot.photo.camera;
        frame.insert("file_path".into(), json!(format!("{up}{}", shot.path())));
        let pose = rows::of(&camera.camera_to_world);
        frame.insert("transform_matrix".into(), json!(pose));
        frame.insert("near".into(), json!(camera.near));
        frame.insert("far".into(), json!(camera.far));
        // Brush and instant-ngp find masks by their names, without a field.
        let masks = self.masks.filter(|_| self.layout == Layout::Nerfstudio);
        if let Some(path) = masks.and_then(|masks| shot.mask_path(masks)) {
            frame.insert("mask_path".into(), json!(path));
        }
        Value::Object(frame)
    }

    /// Where the scene is in instant-ngp's cube, and where its points are.
    fn place(&self, page: &mut Map<String, Value>) {
        if self.layout == Layout::InstantNgp {
            let (scale, offset) = into_unit_cube(self.capture.bounds);
            // The box fills the unit cube, so the cube needs no larger one around it.
            page.insert("aabb_scale".into(), json!(1));
            page.insert("scale".into(), json!(scale));
            page.insert("offset".into(), json!(offset));
        }
        let points = self.layout.points_file();
        let points = points.filter(|_| !self.capture.points.is_empty());
        if let Some(file) = points {
            page.insert("ply_file_path".into(), json!(file));
        }
    }
}

/// nerfstudio has one model for all frames.
fn one_model(lenses: &[Map<String, Value>]) -> Result<Value, LayoutError> {
    let mut models = lenses.iter().filter_map(|lens| lens.get("camera_model"));
    let first = models.next().cloned().unwrap_or_default();
    match models.all(|model| *model == first) {
        true => Ok(first),
        false => Err(LayoutError::Unheld {
            what: "some lenses are fisheyes and some are not".to_owned(),
            layout: Layout::Nerfstudio.name(),
            remedy: "export for colmap or brush, or export the two kinds apart",
        }),
    }
}

/// The scale and the offset that bring a box into the middle of the unit cube: p * scale + offset.
fn into_unit_cube([low, high]: formats::Bounds) -> (f64, [f64; 3]) {
    let longest = (0..3)
        .map(|axis| high[axis] - low[axis])
        .fold(0.0, f64::max);
    let scale = 1.0 / longest;
    // The box's middle goes to 0.5, where instant-ngp's cube has its own.
    let offset = std::array::from_fn(|axis| 0.5 - scale * 0.5 * (low[axis] + high[axis]));
    (scale, offset)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_comes_into_the_middle_of_the_unit_cube() {
        let bounds = [[-1.0, 2.0, 0.0], [3.0, 4.0, 1.0]];
        let (scale, offset) = into_unit_cube(bounds);
        let moved = bounds.map(|p| [0, 1, 2].map(|axis| p[axis] * scale + offset[axis]));
        assert_eq!(moved, [[0.0, 0.25, 0.375], [1.0, 0.75, 0.625]]);
    }
}
