//! Real spherical harmonics up to degree 3, which encode a view direction. Knows nothing of the
//! network they feed.

/// Coefficients of "degree 4" in instant-ngp's count: bands 0 to 3.
pub const COEFFICIENTS: usize = 16;

/// The harmonics at a unit vector, orthonormal over the sphere, in the usual order (l, m = -l..l)
/// and with the Condon-Shortley sign (Sloan 2008, "Stupid spherical harmonics tricks", appendix
/// A2).
pub fn harmonics([x, y, z]: [f32; 3]) -> [f32; COEFFICIENTS] {
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    [
        0.282_094_8,
        -0.488_602_52 * y,
        0.488_602_52 * z,
        -0.488_602_52 * x,
        1.092_548_5 * x * y,
        -1.092_548_5 * y * z,
        0.315_391_57 * (3.0 * zz - 1.0),
        -1.092_548_5 * x * z,
        0.546_274_24 * (xx - yy),
        -0.590_043_6 * y * (3.0 * xx - yy),
        2.890_611_4 * x * y * z,
        -0.457_045_8 * y * (5.0 * zz - 1.0),
        0.373_176_34 * z * (5.0 * zz - 3.0),
        -0.457_045_8 * x * (5.0 * zz - 1.0),
        1.445_305_7 * z * (xx - yy),
        -0.590_043_6 * x * (xx - 3.0 * yy),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integrates products over the sphere: equal steps in longitude, and in z, where area is
    /// uniform.
    #[test]
    fn harmonics_are_orthonormal() {
        const STEPS: usize = 200;
        let mut gram = [[0f64; COEFFICIENTS]; COEFFICIENTS];
        for i in 0..STEPS * STEPS {
            let z = 2.0 * ((i / STEPS) as f64 + 0.5) / STEPS as f64 - 1.0;
            let angle = std::f64::consts::TAU * ((i % STEPS) as f64 + 0.5) / STEPS as f64;
            let ring = (1.0 - z * z).sqrt();
            let y = harmonics([
                (ring * angle.cos()) as f32,
                (ring * angle.sin()) as f32,
                z as f32,
            ]);
            for (row, &a) in gram.iter_mut().zip(&y) {
                row.iter_mut()
                    .zip(&y)
                    .for_each(|(sum, &b)| *sum += f64::from(a * b));
            }
        }
        let area = 2.0 * std::f64::consts::TAU / (STEPS * STEPS) as f64;
        for (i, row) in gram.iter().enumerate() {
            for (j, sum) in row.iter().enumerate() {
                let want = if i == j { 1.0 } else { 0.0 };
                assert!(
                    (sum * area - want).abs() < 1e-3,
                    "<Y{i}, Y{j}> = {}",
                    sum * area
                );
            }
        }
    }
}
