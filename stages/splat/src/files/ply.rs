//! The PLY of 3D Gaussian Splatting: logits of opacities, logarithms of scales, quaternions with
//! their real part first, harmonics channel by channel.

use std::io::{self, Write};

use crate::cloud::{Cloud, Splat};

pub fn write(cloud: &Cloud, out: &mut dyn Write) -> io::Result<()> {
    let rest = 3 * (cloud.coefficients() - 1);
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n",
        cloud.splats.len()
    )?;
    for name in names(rest) {
        writeln!(out, "property float {name}")?;
    }
    out.write_all(b"end_header\n")?;
    for splat in &cloud.splats {
        for value in values(splat, cloud.coefficients()) {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

fn names(rest: usize) -> Vec<String> {
    let fixed = |names: &[&str]| {
        names
            .iter()
            .map(|name| (*name).to_owned())
            .collect::<Vec<_>>()
    };
    let mut names = fixed(&[
        // Names and order are those of Kerbl et al.'s program: viewers find columns by them.
        "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2",
    ]);
    names.extend((0..rest).map(|i| format!("f_rest_{i}")));
    names.extend(fixed(&["opacity", "scale_0", "scale_1", "scale_2"]));
    names.extend(fixed(&["rot_0", "rot_1", "rot_2", "rot_3"]));
    names
}

fn values(splat: &Splat, coefficients: usize) -> Vec<f32> {
    let [_, _, normal] = splat.axes();
    let turning = &splat.harmonics[1..coefficients];
    // Channel by channel, as that program flattens its tensor [channels, coefficients].
    let rest = (0..3).flat_map(|channel| turning.iter().map(move |part| part[channel]));
    let turn = splat.rotation;
    let head = [
        splat.position.to_array(),
        normal.to_array(),
        splat.harmonics[0],
    ];
    head.into_iter()
        .flatten()
        .chain(rest)
        .chain([splat.logit])
        .chain(splat.log_scale.to_array())
        .chain([turn.w, turn.x, turn.y, turn.z])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::MOST;
    use glam::{Quat, Vec3};

    #[test]
    fn a_splat_takes_as_many_bytes_as_its_header_says() {
        let mut harmonics = [[0.0; 3]; MOST];
        harmonics[1] = [0.1, 0.2, 0.3];
        harmonics[2] = [0.4, 0.5, 0.6];
        let splat = Splat {
            position: Vec3::new(1.0, 2.0, 3.0),
            rotation: Quat::IDENTITY,
            log_scale: Vec3::splat(-3.0),
            logit: 0.7,
            harmonics,
        };
        let cloud = Cloud {
            splats: vec![splat; 3],
            degree: 1,
        };
        let mut bytes = Vec::new();
        write(&cloud, &mut bytes).unwrap();
        let end = bytes
            .windows(11)
            .position(|part| part == b"end_header\n")
            .unwrap()
            + 11;
        let header = String::from_utf8(bytes[..end].to_vec()).unwrap();
        assert_eq!(header.matches("property float").count(), 26);
        assert_eq!(bytes.len() - end, 3 * 26 * 4);
        let value = |i: usize| {
            let at = end + 4 * i;
            f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
        };
        assert_eq!(
            [value(0), value(9), value(10), value(12)],
            [1.0, 0.1, 0.4, 0.2]
        );
        assert_eq!([value(18), value(19), value(22)], [0.7, -3.0, 1.0]);
    }
}
