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

/// The backward pass of [`harmonics`] to the direction, as a vector of space: what of it points
/// along the direction itself means nothing.
pub fn harmonics_backward([x, y, z]: [f32; 3], d: &[f32]) -> [f32; 3] {
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    // By the coefficients' own terms: d[i] is the gradient to coefficient i. Band 0 is constant.
    let band1 = [
        -0.488_602_52 * d[3],
        -0.488_602_52 * d[1],
        0.488_602_52 * d[2],
    ];
    let band2 = [
        1.092_548_5 * (y * d[4] - z * d[7] + x * d[8]),
        1.092_548_5 * (x * d[4] - z * d[5] - y * d[8]),
        1.092_548_5 * (-y * d[5] - x * d[7]) + 1.892_349_4 * z * d[6],
    ];
    let band3 = [
        -3.540_261_5 * x * y * d[9] + 2.890_611_4 * y * z * d[10]
            - 0.457_045_8 * (5.0 * zz - 1.0) * d[13]
            + 2.890_611_4 * x * z * d[14]
            - 1.770_130_8 * (xx - yy) * d[15],
        -1.770_130_8 * (xx - yy) * d[9] + 2.890_611_4 * x * z * d[10]
            - 0.457_045_8 * (5.0 * zz - 1.0) * d[11]
            - 2.890_611_4 * y * z * d[14]
            + 3.540_261_5 * x * y * d[15],
        2.890_611_4 * x * y * d[10] - 4.570_458 * y * z * d[11]
            + 0.373_176_34 * (15.0 * zz - 3.0) * d[12]
            - 4.570_458 * x * z * d[13]
            + 1.445_305_7 * (xx - yy) * d[14],
    ];
    std::array::from_fn(|axis| band1[axis] + band2[axis] + band3[axis])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_to_the_direction_matches_finite_differences() {
        let at = [0.48, -0.6, 0.64];
        for i in 0..COEFFICIENTS {
            let mut d = [0.0; COEFFICIENTS];
            d[i] = 1.0;
            let analytic = harmonics_backward(at, &d);
            for axis in 0..3 {
                let value = |step: f32| {
                    let mut moved = at;
                    moved[axis] += step;
                    harmonics(moved)[i]
                };
                let numeric = (value(1e-2) - value(-1e-2)) / 2e-2;
                let got = analytic[axis];
                assert!(
                    (got - numeric).abs() < 2e-3,
                    "Y{i} axis {axis}: {got} {numeric}"
                );
            }
        }
    }

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
