//! Real spherical harmonics as files of splats hold them (with the Condon-Shortley phase), up to the
//! second degree. Knows no splats.

use glam::Vec3;

/// The highest degree that is supported.
pub const HIGHEST: u32 = 2;
/// Coefficients of all degrees.
pub const MOST: usize = 9;
/// The value of the first function, which is the same everywhere.
pub const FLAT: f32 = 0.282_094_8;

/// How many functions there are up to a degree.
pub fn count(degree: u32) -> usize {
    (degree as usize + 1).pow(2)
}

/// The functions' values in a unit direction.
pub fn values(direction: Vec3) -> [f32; MOST] {
    // Factors as in Kerbl et al.'s program: sqrt(3 / (4 pi)) and so on, to single precision.
    const FIRST: f32 = 0.488_602_52;
    const SECOND: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_2];
    let Vec3 { x, y, z } = direction;
    [
        FLAT,
        -FIRST * y,
        FIRST * z,
        -FIRST * x,
        SECOND[0] * x * y,
        -SECOND[0] * y * z,
        SECOND[1] * (2.0 * z * z - x * x - y * y),
        -SECOND[0] * x * z,
        SECOND[2] * (x * x - y * y),
    ]
}

/// The colour that coefficients give where the functions have these values; not below black.
pub fn color(coefficients: &[[f32; 3]], values: &[f32; MOST]) -> [f32; 3] {
    raw(coefficients, values).map(|channel| channel.max(0.0))
}

/// The derivative by each coefficient is its function's value, but where black held the colour.
pub fn color_backward(
    coefficients: &[[f32; 3]],
    values: &[f32; MOST],
    by_color: [f32; 3],
    by_coefficients: &mut [[f32; 3]],
) {
    let raw = raw(coefficients, values);
    for (by_coefficient, value) in by_coefficients.iter_mut().zip(values) {
        for channel in 0..3 {
            // Held at black the colour does not follow, and so has no derivative.
            if raw[channel] > 0.0 {
                by_coefficient[channel] += value * by_color[channel];
            }
        }
    }
}

fn raw(coefficients: &[[f32; 3]], values: &[f32; MOST]) -> [f32; 3] {
    // Splat files add 1/2 to what their harmonics give.
    let mut color = [0.5; 3];
    for (coefficient, value) in coefficients.iter().zip(values) {
        for (channel, part) in color.iter_mut().zip(coefficient) {
            *channel += value * part;
        }
    }
    color
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_functions_are_orthonormal_over_the_sphere() {
        // A Fibonacci lattice covers the sphere evenly.
        const POINTS: u32 = 20_000;
        let mut products = [[0.0_f64; MOST]; MOST];
        for i in 0..POINTS {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(POINTS);
            let angle = 2.399_963_229_728_653 * f64::from(i);
            let ring = (1.0 - z * z).sqrt();
            let at = Vec3::new(
                (ring * angle.cos()) as f32,
                (ring * angle.sin()) as f32,
                z as f32,
            );
            let values = values(at).map(f64::from);
            for (row, a) in products.iter_mut().zip(values) {
                row.iter_mut()
                    .zip(values)
                    .for_each(|(sum, b)| *sum += a * b);
            }
        }
        let share = 4.0 * std::f64::consts::PI / f64::from(POINTS);
        for (i, row) in products.iter().enumerate() {
            for (j, product) in row.iter().enumerate() {
                let expected = f64::from(u8::from(i == j));
                assert!((product * share - expected).abs() < 1e-3, "{i} {j}");
            }
        }
    }
}
