//! OpenUSD's text with a `ParticleField3DGaussianSplat`: opacities and scales as they are,
//! quaternions with their real part first, harmonics splat by splat.

use std::fmt::Display;
use std::io::{self, Write};

use super::Up;
use super::gltf::corners;
use crate::cloud::{Cloud, Splat};

pub fn write(cloud: &Cloud, up: Up, out: &mut dyn Write) -> io::Result<()> {
    let up = match up {
        Up::Y => "Y",
        Up::Z => "Z",
    };
    writeln!(
        out,
        "#usda 1.0\n(\n    defaultPrim = \"splats\"\n    upAxis = \"{up}\"\n)\n"
    )?;
    writeln!(
        out,
        "def ParticleField3DGaussianSplat \"splats\" (\n    prepend apiSchemas = [\"ColorSpaceAPI\"]\n)\n{{"
    )?;
    writeln!(
        out,
        "    uniform token colorSpace:name = \"srgb_rec709_display\""
    )?;
    let degree = cloud.degree;
    writeln!(
        out,
        "    uniform int radiance:sphericalHarmonicsDegree = {degree}"
    )?;
    let [low, high] = corners(cloud).map(|corner| tuple(&corner.to_array()));
    writeln!(out, "    float3[] extent = [{low}, {high}]")?;
    let splats = &cloud.splats;
    let each = |of: fn(&Splat) -> String| splats.iter().map(of);
    list(
        out,
        "point3f[] positions",
        each(|s| tuple(&s.position.to_array())),
    )?;
    list(out, "quatf[] orientations", each(turn))?;
    list(
        out,
        "float3[] scales",
        each(|s| tuple(&s.scale().to_array())),
    )?;
    list(out, "float[] opacities", each(|s| s.opacity().to_string()))?;
    let harmonics = splats
        .iter()
        .flat_map(|s| &s.harmonics[..cloud.coefficients()]);
    let harmonics = harmonics.map(|part| tuple(part));
    list(
        out,
        "float3[] radiance:sphericalHarmonicsCoefficients",
        harmonics,
    )?;
    writeln!(out, "}}")
}

fn turn(splat: &Splat) -> String {
    let turn = splat.rotation;
    tuple(&[turn.w, turn.x, turn.y, turn.z])
}

fn tuple(numbers: &[f32]) -> String {
    // The shortest decimal that reads back as the same f32.
    let words: Vec<String> = numbers.iter().map(f32::to_string).collect();
    format!("({})", words.join(", "))
}

fn list(
    out: &mut dyn Write,
    name: &str,
    items: impl Iterator<Item = impl Display>,
) -> io::Result<()> {
    write!(out, "    {name} = [")?;
    for (i, item) in items.enumerate() {
        let comma = if i == 0 { "" } else { ", " };
        write!(out, "{comma}{item}")?;
    }
    writeln!(out, "]")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::MOST;
    use glam::{Quat, Vec3};

    #[test]
    fn a_splat_is_one_item_of_each_list() {
        let splat = Splat {
            position: Vec3::new(1.0, 2.0, 3.5),
            rotation: Quat::IDENTITY,
            log_scale: Vec3::ZERO,
            logit: 0.0,
            harmonics: [[0.25; 3]; MOST],
        };
        let cloud = Cloud {
            splats: vec![splat; 2],
            degree: 0,
        };
        let mut bytes = Vec::new();
        write(&cloud, Up::Y, &mut bytes).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        for line in [
            "    uniform int radiance:sphericalHarmonicsDegree = 0\n",
            "    point3f[] positions = [(1, 2, 3.5), (1, 2, 3.5)]\n",
            "    quatf[] orientations = [(1, 0, 0, 0), (1, 0, 0, 0)]\n",
            "    float3[] scales = [(1, 1, 1), (1, 1, 1)]\n",
            "    float[] opacities = [0.5, 0.5]\n",
            "    float3[] radiance:sphericalHarmonicsCoefficients = [(0.25, 0.25, 0.25), (0.25, 0.25, 0.25)]\n",
        ] {
            assert!(text.contains(line), "{line} is not in\n{text}");
        }
    }
}
