//! Lenses as other programs write them down. Knows no poses.

use formats::{Camera, Distortion, Lens};
use serde_json::{Map, Value, json};

use super::{Layout, LayoutError};

/// What to do with a lens that a program does not know.
const REMEDY: &str =
    "export colmap holds every lens of OpenCV's; or render the field with pinholes";

/// The part of a lens that a `transforms.json` of this program holds.
fn held(layout: Layout, lens: &Distortion) -> Distortion {
    let Distortion { k1, k2, p1, p2, .. } = *lens;
    if lens.fisheye {
        return Distortion::fisheye([k1, k2, lens.k3, lens.k4]);
    }
    // Of the others only nerfstudio goes on to r⁶, and none divides.
    let k3 = match layout {
        Layout::Nerfstudio => lens.k3,
        _ => 0.0,
    };
    Distortion {
        k1,
        k2,
        k3,
        p1,
        p2,
        ..Distortion::default()
    }
}

/// The fields of a lens in a `transforms.json`.
pub(super) fn fields(layout: Layout, camera: &Camera) -> Result<Map<String, Value>, LayoutError> {
    let lens = camera.distortion;
    // A coefficient that is lost would bend every ray, so the lens is refused as a whole.
    if held(layout, &lens) != lens {
        return Err(unheld(layout, &lens));
    }
    // Frames have a near and a far of their own.
    let shared = Lens {
        near: None,
        far: None,
        ..Lens::of(camera)
    };
    let mut fields = match json!(shared) {
        Value::Object(fields) => fields,
        _ => Map::new(),
    };
    let model = formats::lens::model([&lens].into_iter());
    fields.insert("camera_model".into(), json!(model));
    Ok(fields)
}

/// COLMAP's camera model and its parameters.
pub(super) fn colmap(camera: &Camera) -> Result<(&'static str, Vec<f64>), LayoutError> {
    let lens = camera.distortion;
    let Distortion { k1, k2, k3, .. } = lens;
    let Distortion { k4, k5, k6, .. } = lens;
    let Distortion { p1, p2, .. } = lens;
    let short = Distortion {
        k1,
        k2,
        p1,
        p2,
        ..Distortion::default()
    };
    let full = Distortion {
        k3,
        k4,
        k5,
        k6,
        ..short
    };
    // The simplest model that holds all coefficients: more programs read those.
    let (model, bent) = if lens.is_none() {
        ("PINHOLE", vec![])
    } else if lens == Distortion::fisheye([k1, k2, k3, k4]) {
        ("OPENCV_FISHEYE", vec![k1, k2, k3, k4])
    } else if lens == short {
        ("OPENCV", vec![k1, k2, p1, p2])
    } else if lens == full {
        ("FULL_OPENCV", vec![k1, k2, p1, p2, k3, k4, k5, k6])
    } else {
        return Err(unheld(Layout::Colmap, &lens));
    };
    let pinhole = [camera.fl_x, camera.fl_y, camera.cx, camera.cy];
    Ok((model, pinhole.into_iter().chain(bent).collect()))
}

fn unheld(layout: Layout, lens: &Distortion) -> LayoutError {
    LayoutError::Unheld {
        what: format!("the lens has {lens}"),
        layout: layout.name(),
        remedy: REMEDY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat4;

    fn camera(distortion: Distortion) -> Camera {
        Camera {
            distortion,
            ..Camera::centered((40, 30), 50.0, DMat4::IDENTITY, [1.0, 2.0])
        }
    }

    #[test]
    fn each_program_holds_the_lenses_that_it_knows_and_refuses_others() {
        let [radial, rational] = [
            Distortion {
                k3: 0.1,
                ..Distortion::default()
            },
            Distortion {
                k5: 0.1,
                ..Distortion::default()
            },
        ];
        let holds = |layout, lens| fields(layout, &camera(lens)).is_ok();
        assert!(holds(Layout::Nerfstudio, radial));
        assert!(!holds(Layout::Brush, radial) && !holds(Layout::InstantNgp, radial));
        assert!(!holds(Layout::Nerfstudio, rational));
        assert!(holds(Layout::Brush, Distortion::fisheye([0.1; 4])));
        assert_eq!(colmap(&camera(rational)).unwrap().0, "FULL_OPENCV");
        assert_eq!(colmap(&camera(Distortion::default())).unwrap().1.len(), 4);
        let said = fields(Layout::Brush, &camera(radial)).unwrap_err();
        assert_eq!(
            said.to_string(),
            "the lens has k3 = 0.1, which brush cannot hold"
        );
    }
}
