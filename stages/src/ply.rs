//! Writes a surface as a binary PLY file, as MeshLab, Blender and Open3D read it. Knows nothing of
//! fields.
//!
//! Format: Greg Turk, "The PLY polygon file format", 1994.

use std::io::{self, Write};

use crate::surface::Surface;

/// Writes the vertices with normals and 8-bit colours, and the triangles unless only `points` are
/// wanted.
///
/// # Errors
/// If `out` takes no more.
pub fn write(surface: &Surface, points: bool, out: &mut impl Write) -> io::Result<()> {
    let triangles: &[[u32; 3]] = if points { &[] } else { &surface.triangles };
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n",
        surface.vertices.len()
    )?;
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        writeln!(out, "property float {name}")?;
    }
    for name in ["red", "green", "blue"] {
        writeln!(out, "property uchar {name}")?;
    }
    if !points {
        write!(
            out,
            "element face {}\nproperty list uchar int vertex_indices\n",
            triangles.len()
        )?;
    }
    out.write_all(b"end_header\n")?;
    for vertex in &surface.vertices {
        for value in vertex.position.iter().chain(&vertex.normal) {
            out.write_all(&value.to_le_bytes())?;
        }
        out.write_all(&vertex.bytes())?;
    }
    for triangle in triangles {
        // A list begins with its length.
        out.write_all(&[3])?;
        triangle
            .iter()
            .try_for_each(|vertex| out.write_all(&vertex.to_le_bytes()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::Vertex;

    #[test]
    fn a_triangle_takes_as_many_bytes_as_its_header_says() {
        let vertex = |x| Vertex {
            position: [x, 0.5, -1.0],
            normal: [0.0, 0.0, 1.0],
            color: [1.0, 0.5, -0.1],
        };
        let surface = Surface {
            vertices: [0.0, 1.0, 2.0].map(vertex).to_vec(),
            triangles: vec![[0, 1, 2]],
        };
        let mut bytes = Vec::new();
        write(&surface, false, &mut bytes).unwrap();
        let header = bytes
            .windows(11)
            .position(|part| part == b"end_header\n")
            .unwrap()
            + 11;
        assert!(bytes.starts_with(
            b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n"
        ));
        assert_eq!(bytes.len() - header, 3 * (6 * 4 + 3) + 1 + 3 * 4);
        assert_eq!(bytes[header + 27..header + 31], 1f32.to_le_bytes());
        assert_eq!(bytes[header + 24..header + 27], [255, 128, 0]);
        let mut points = Vec::new();
        write(&surface, true, &mut points).unwrap();
        assert!(!String::from_utf8_lossy(&points).contains("face"));
    }
}
