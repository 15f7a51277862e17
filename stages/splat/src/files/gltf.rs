//! A binary glTF 2.0 of points with the extension `KHR_gaussian_splatting`: opacities and scales as
//! they are, quaternions with their real part last, one attribute for each harmonic.

use std::io::{self, Write};

use formats::shot::glb;
use glam::Vec3;
use serde_json::{Map, Value, json};

use super::Up;
use crate::cloud::{Cloud, Splat};

const EXTENSION: &str = "KHR_gaussian_splatting";
/// glTF's numbers for 32-bit floats, for points, and for a buffer of vertices.
const FLOAT: u32 = 5126;
const POINTS: u32 = 0;
const ARRAY_BUFFER: u32 = 34962;
/// A quarter turn about x, which takes +z to +y, glTF's upwards.
const Z_TO_Y: [f32; 4] = [
    -std::f32::consts::FRAC_1_SQRT_2,
    0.0,
    0.0,
    std::f32::consts::FRAC_1_SQRT_2,
];

/// The numbers of a splat in a column.
type Row = Box<dyn Fn(&Splat) -> Vec<f32>>;

/// A column of numbers, one row a splat.
struct Column {
    name: String,
    kind: &'static str,
    width: usize,
    row: Row,
}

pub fn write(cloud: &Cloud, up: Up, out: &mut dyn Write) -> io::Result<()> {
    let columns = columns(cloud);
    let row: usize = columns.iter().map(|column| 4 * column.width).sum();
    // Checked before the first byte is written: glTF counts bytes in 32 bits.
    let length = u32::try_from(row * cloud.splats.len())
        .map_err(|_| io::Error::other("more splats than 4 GiB hold; ask for fewer"))?;
    glb::head(
        page(cloud, up, &columns, length).to_string(),
        length as usize,
        out,
    )?;
    // Column by column, as the buffer views lie, and never as one buffer in memory.
    for column in &columns {
        for value in cloud.splats.iter().flat_map(&column.row) {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

fn columns(cloud: &Cloud) -> Vec<Column> {
    let column = |name: &str, kind, width, row: Row| Column {
        name: name.to_owned(),
        kind,
        width,
        row,
    };
    let own = |name: &str| format!("{EXTENSION}:{name}");
    let mut columns = vec![
        column(
            "POSITION",
            "VEC3",
            3,
            Box::new(|s| s.position.to_array().to_vec()),
        ),
        // What a program shows that knows no splats.
        column("COLOR_0", "VEC4", 4, Box::new(plain_color)),
        column(
            &own("ROTATION"),
            "VEC4",
            4,
            Box::new(|s| s.rotation.to_array().to_vec()),
        ),
        column(
            &own("SCALE"),
            "VEC3",
            3,
            Box::new(|s| s.scale().to_array().to_vec()),
        ),
        column(
            &own("OPACITY"),
            "SCALAR",
            1,
            Box::new(|s| vec![s.opacity()]),
        ),
    ];
    for i in 0..cloud.coefficients() {
        let degree = i.isqrt();
        let name = own(&format!("SH_DEGREE_{degree}_COEF_{}", i - degree * degree));
        let row = move |splat: &Splat| splat.harmonics[i].to_vec();
        columns.push(column(&name, "VEC3", 3, Box::new(row)));
    }
    columns
}

/// In linear light, as glTF has it.
fn plain_color(splat: &Splat) -> Vec<f32> {
    let [r, g, b] = splat.flat_color().map(formats::color::srgb_to_linear);
    vec![r, g, b, splat.opacity()]
}

fn page(cloud: &Cloud, up: Up, columns: &[Column], length: u32) -> Value {
    let mut attributes = Map::new();
    let mut accessors = Vec::new();
    let mut views = Vec::new();
    let mut offset = 0;
    for (i, column) in columns.iter().enumerate() {
        let bytes = 4 * column.width * cloud.splats.len();
        attributes.insert(column.name.clone(), json!(i));
        views.push(
            json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes, "target": ARRAY_BUFFER}),
        );
        accessors.push(json!({
            "bufferView": i, "componentType": FLOAT, "count": cloud.splats.len(), "type": column.kind,
        }));
        offset += bytes;
    }
    // The format demands the bounds of positions.
    let [low, high] = corners(cloud);
    accessors[0]["min"] = json!(low.to_array());
    accessors[0]["max"] = json!(high.to_array());
    let mut node = json!({"mesh": 0, "name": "splats"});
    if up == Up::Z {
        node["rotation"] = json!(Z_TO_Y);
    }
    json!({
        "asset": {"version": "2.0", "generator": "srnerf-dag"},
        // Used and not required: programs that know no splats still show points.
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{
            "mode": POINTS,
            "attributes": attributes,
            "extensions": {EXTENSION: {
                "kernel": "ellipse",
                "colorSpace": "srgb_rec709_display",
                "sortingMethod": "zDepth",
            }},
        }]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": length}],
    })
}

/// The box around the middles.
pub fn corners(cloud: &Cloud) -> [Vec3; 2] {
    let middles = cloud.splats.iter().map(|splat| splat.position);
    let empty = [Vec3::INFINITY, Vec3::NEG_INFINITY];
    middles.fold(empty, |[low, high], at| [low.min(at), high.max(at)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::MOST;
    use glam::Quat;

    #[test]
    fn a_file_has_the_length_that_it_says_and_an_attribute_for_each_harmonic() {
        let splat = Splat {
            position: Vec3::new(1.0, 2.0, 3.0),
            rotation: Quat::IDENTITY,
            log_scale: Vec3::splat(-3.0),
            logit: 0.0,
            harmonics: [[0.0; 3]; MOST],
        };
        let cloud = Cloud {
            splats: vec![splat; 3],
            degree: 1,
        };
        let mut bytes = Vec::new();
        write(&cloud, Up::Z, &mut bytes).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!(&bytes[..4], b"glTF");
        assert_eq!([word(4), word(8)], [2, bytes.len() as u32]);
        let json = word(12) as usize;
        let page: Value = serde_json::from_slice(&bytes[20..20 + json]).unwrap();
        assert_eq!(
            word(20 + json) as usize,
            3 * 4 * (3 + 4 + 4 + 3 + 1 + 4 * 3)
        );
        let attributes = &page["meshes"][0]["primitives"][0]["attributes"];
        assert_eq!(attributes.as_object().unwrap().len(), 5 + 4);
        assert_eq!(attributes["KHR_gaussian_splatting:SH_DEGREE_1_COEF_2"], 8);
        assert_eq!(page["accessors"][0]["max"], json!([1.0, 2.0, 3.0]));
        let opacity = 28 + json + 3 * 4 * (3 + 4 + 4 + 3);
        assert_eq!(bytes[opacity..opacity + 4], 0.5f32.to_le_bytes());
    }
}
