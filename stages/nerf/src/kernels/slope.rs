//! How hash features change with the position: the backward pass of the trilinear look-up to where
//! it was made. Knows nothing of rays.

use super::hash::{CORNERS, Entry, entry, widen};
use crate::config::{FEATURES, Level};

/// Adds the gradient to positions, from that to the features of one level, whose entries `table`
/// holds.
pub fn positions_backward(
    level: &Level,
    table: &[Entry],
    positions: [&[f32]; 3],
    d_features: &[[f32; FEATURES]],
    d_positions: &mut [[f32; 3]],
) {
    for (i, (d_position, d)) in d_positions.iter_mut().zip(d_features).enumerate() {
        let slope = slope(level, table, positions.map(|axis| axis[i]), *d);
        d_position
            .iter_mut()
            .zip(slope)
            .for_each(|(sum, d)| *sum += d);
    }
}

/// The gradient of one position. Within a cell a feature is linear along each axis; on its faces
/// the slope is that of the cell that the look-up takes.
fn slope(level: &Level, table: &[Entry], position: [f32; 3], d: [f32; FEATURES]) -> [f32; 3] {
    // The look-up's own shift, so that both take the same cell.
    let place = position.map(|x| x * level.scale + 0.5);
    let cell = place.map(|x| x as i32 as u32);
    let fraction = place.map(|x| x - (x as i32) as f32);
    let mut sum = [0.0; 3];
    for corner in 0..CORNERS {
        let side = [corner & 1, corner >> 1 & 1, corner >> 2];
        let vertex = [0, 1, 2].map(|a| cell[a].wrapping_add(side[a] as u32));
        let [first, second] = table[entry(level, vertex) as usize].map(widen);
        let value = d[0] * first + d[1] * second;
        let weight = [0, 1, 2].map(|a| {
            if side[a] == 1 {
                fraction[a]
            } else {
                1.0 - fraction[a]
            }
        });
        // The derivative of f is 1 and that of 1 - f is -1, along the axis asked for.
        let sign = side.map(|side| if side == 1 { 1.0 } else { -1.0 });
        sum[0] += value * sign[0] * weight[1] * weight[2];
        sum[1] += value * sign[1] * weight[0] * weight[2];
        sum[2] += value * sign[2] * weight[0] * weight[1];
    }
    // From cells to unit space.
    sum.map(|d| d * level.scale)
}

#[cfg(test)]
mod tests {
    use super::super::hash::{LANES, encode};
    use super::*;
    use crate::config::FieldConfig;
    use compute::rng::Rng;
    use half::f16;

    #[test]
    fn the_gradient_matches_finite_differences_on_dense_and_hashed_levels() {
        let config = FieldConfig {
            levels: 4,
            log2_table: 9,
            base_resolution: 4,
            finest_resolution: 24,
            ..FieldConfig::default()
        };
        let levels = config.levels([1.0, 0.5, 0.75]);
        assert!(levels.iter().any(|level| level.dense) && !levels[3].dense);
        let rng = Rng::new(5, "slope test");
        for level in &levels {
            let table: Vec<Entry> = (0..level.entries)
                .map(|i| [0, 1].map(|f| f16::from_f32(rng.normal(f, i as u64))))
                .collect();
            // Positions whose steps stay within a cell.
            let positions: [Vec<f32>; 3] = [0, 1, 2].map(|axis| {
                (0..LANES as u64)
                    .map(|i| {
                        let cell = (rng.uniform(2 + axis, i) * 0.5 * level.scale).floor();
                        let inside = 0.2 + 0.6 * rng.uniform(5 + axis, i);
                        (cell + 0.5 + inside) / level.scale
                    })
                    .collect()
            });
            let d = [0.7, -1.3];
            let value = |axis: usize, step: f32| -> Vec<f32> {
                let mut moved = positions.clone();
                moved[axis].iter_mut().for_each(|x| *x += step);
                let mut out = vec![[0.0; FEATURES]; LANES];
                encode(level, &table, moved.each_ref().map(|x| &x[..]), &mut out);
                out.iter().map(|f| d[0] * f[0] + d[1] * f[1]).collect()
            };
            let mut analytic = vec![[0.0; 3]; LANES];
            let at = positions.each_ref().map(|x| &x[..]);
            positions_backward(level, &table, at, &[d; LANES], &mut analytic);
            let step = 0.1 / level.scale;
            for axis in 0..3 {
                let ahead = value(axis, step);
                let back = value(axis, -step);
                for (d, (ahead, back)) in analytic.iter().zip(ahead.iter().zip(back)) {
                    let numeric = (ahead - back) / (2.0 * step);
                    let off = (d[axis] - numeric).abs();
                    assert!(off < 1e-2 * (1.0 + numeric.abs()), "{d:?} {numeric}");
                }
            }
        }
    }
}
