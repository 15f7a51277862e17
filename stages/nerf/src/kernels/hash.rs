//! Trilinear look-up in the multiresolution hash grid, and its backward pass (Müller et al. 2022, section 3). Knows
//! nothing of rays or networks.
//!
//! Positions lie in unit space, in groups of [`LANES`]; callers pad. Entries are half-precision numbers, so that a level
//! stays in the second-level cache; sums are single-precision. With AVX-512 the look-ups of a group are gathers
//! ([`super::wide`]), elsewhere they are made one by one; the bits are the same.

#[cfg(target_arch = "x86_64")]
use super::wide::Avx512;
use crate::config::{FEATURES, Level};
use half::f16;
use pulp::{Arch, Simd, WithSimd};

/// A hash entry as look-ups read it.
pub type Entry = [f16; FEATURES];

/// Samples whose corners are worked out together: position counts are multiples of it.
pub const LANES: usize = 16;
/// Corners of a cell.
pub const CORNERS: usize = 8;
/// Factors of the spatial hash for y and z; x has 1 (the paper's equation 4).
pub const PRIMES: [u32; 2] = [2_654_435_761, 805_459_861];

/// Positions in unit space, one array per axis.
#[derive(Clone, Debug, Default)]
pub struct Positions(pub [Vec<f32>; 3]);

impl Positions {
    /// How many there are, padding included.
    pub fn len(&self) -> usize {
        self.0[0].len()
    }

    /// Adds a position.
    pub fn push(&mut self, position: [f32; 3]) {
        self.0.iter_mut().zip(position).for_each(|(axis, x)| axis.push(x));
    }

    /// Repeats the origin until whole groups are full.
    pub fn pad(&mut self) {
        let len = self.len().next_multiple_of(LANES);
        self.0.iter_mut().for_each(|axis| axis.resize(len, 0.0));
    }

    /// Adds whole groups.
    pub fn extend(&mut self, more: &Self) {
        self.0.iter_mut().zip(&more.0).for_each(|(axis, more)| axis.extend_from_slice(more));
    }

    /// Adds those of `from` with these indices.
    pub fn gather(&mut self, from: &Self, indices: &[u32]) {
        for (axis, from) in self.0.iter_mut().zip(&from.0) {
            axis.extend(indices.iter().map(|&index| from[index as usize]));
        }
    }

    /// Forgets all positions.
    pub fn clear(&mut self) {
        self.0.iter_mut().for_each(Vec::clear);
    }

    /// A group's coordinates, one array per axis.
    #[inline(always)]
    pub fn group(&self, group: usize) -> [&[f32; LANES]; 3] {
        self.0.each_ref().map(|axis| &axis.as_chunks::<LANES>().0[group])
    }
}

/// Entries and trilinear weights of the corners around a group of positions.
pub struct Corners {
    /// Which entry of the level, by corner.
    pub entry: [[u32; LANES]; CORNERS],
    /// How much of it.
    pub weight: [[f32; LANES]; CORNERS],
}

/// What differs between instruction sets.
pub trait Kernel: Copy {
    /// The corners around a group.
    fn corners(self, level: &Level, positions: [&[f32; LANES]; 3]) -> Corners;
    /// The features of a group.
    fn look_up(self, level: &Level, table: &[Entry], positions: [&[f32; LANES]; 3]) -> [[f32; FEATURES]; LANES];
}

/// Ordinary code, which compilers turn into SIMD code where they can.
#[derive(Clone, Copy)]
struct Portable;

impl Kernel for Portable {
    #[inline(always)]
    fn corners(self, level: &Level, positions: [&[f32; LANES]; 3]) -> Corners {
        let mut cell = [[0u32; LANES]; 3];
        let mut fraction = [[0f32; LANES]; 3];
        for axis in 0..3 {
            for lane in 0..LANES {
                // Half a cell's shift staggers the levels (instant-ngp); positions are never negative.
                let x = positions[axis][lane] * level.scale + 0.5;
                cell[axis][lane] = x as i32 as u32;
                fraction[axis][lane] = x - (x as i32) as f32;
            }
        }
        let mut corners = Corners { entry: [[0; LANES]; CORNERS], weight: [[0.0; LANES]; CORNERS] };
        for corner in 0..CORNERS {
            let offset = [corner as u32 & 1, corner as u32 >> 1 & 1, corner as u32 >> 2];
            for lane in 0..LANES {
                corners.entry[corner][lane] = entry(level, [0, 1, 2].map(|a| cell[a][lane].wrapping_add(offset[a])));
                let [x, y, z] = [0, 1, 2].map(|axis| {
                    let f = fraction[axis][lane];
                    if offset[axis] == 1 { f } else { 1.0 - f }
                });
                corners.weight[corner][lane] = x * y * z;
            }
        }
        corners
    }

    #[inline(always)]
    fn look_up(self, level: &Level, table: &[Entry], positions: [&[f32; LANES]; 3]) -> [[f32; FEATURES]; LANES] {
        let corners = self.corners(level, positions);
        std::array::from_fn(|lane| {
            let mut sum = [0f32; FEATURES];
            for corner in 0..CORNERS {
                let entry = table[corners.entry[corner][lane] as usize].map(widen);
                let weight = corners.weight[corner][lane];
                sum = [entry[0].mul_add(weight, sum[0]), entry[1].mul_add(weight, sum[1])];
            }
            sum
        })
    }
}

/// The entry of a vertex.
#[inline(always)]
fn entry(level: &Level, [x, y, z]: [u32; 3]) -> u32 {
    let [nx, ny, _] = level.resolution;
    let entries = level.entries as u32;
    if !level.dense {
        return (x ^ y.wrapping_mul(PRIMES[0]) ^ z.wrapping_mul(PRIMES[1])) & (entries - 1);
    }
    // A corner past the last vertex wraps into the next row, as in instant-ngp. What lies outside the box stays harmless.
    let i = x.wrapping_add(nx.wrapping_mul(y.wrapping_add(ny.wrapping_mul(z))));
    i.min(i.wrapping_sub(entries)).min(entries - 1)
}

/// A finite half as an f32, exactly: its exponent is moved, and the difference of the biases is multiplied out.
#[inline(always)]
fn widen(half: f16) -> f32 {
    const BIAS: f32 = f32::from_bits((127 + 112) << 23);
    let bits = u32::from(half.to_bits());
    f32::from_bits((bits & 0x8000) << 16 | (bits & 0x7fff) << 13) * BIAS
}

/// Features of all levels at all positions: `out[i * width + 2 l + f]`; columns past the levels are left alone.
pub fn encode(levels: &[Level], table: &[Entry], positions: &Positions, out: &mut [f32], width: usize) {
    assert_eq!(out.len(), positions.len() * width, "encode: output size");
    #[cfg(target_arch = "x86_64")]
    if let Some(avx512) = Avx512::new() {
        return Simd::vectorize(avx512.0, Encode { levels, table, positions, out, width, kernel: avx512 });
    }
    Arch::new().dispatch(Encode { levels, table, positions, out, width, kernel: Portable });
}

struct Encode<'a, K> {
    levels: &'a [Level],
    table: &'a [Entry],
    positions: &'a Positions,
    out: &'a mut [f32],
    width: usize,
    kernel: K,
}

impl<K: Kernel> WithSimd for Encode<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (l, level) in self.levels.iter().enumerate() {
            let table = &self.table[level.offset..level.offset + level.entries];
            for (group, out) in self.out.chunks_exact_mut(LANES * self.width).enumerate() {
                let features = self.kernel.look_up(level, table, self.positions.group(group));
                for (out, features) in out.chunks_exact_mut(self.width).zip(features) {
                    out[FEATURES * l..FEATURES * (l + 1)].copy_from_slice(&features);
                }
            }
        }
    }
}

/// The backward pass of one level of [`encode`]: adds to `d_table` (that level's entries) from `d_features`, one pair per
/// position. Positions are taken in order, so the sums have one order.
pub fn encode_backward(
    level: &Level,
    positions: &Positions,
    d_features: &[[f32; FEATURES]],
    d_table: &mut [[f32; FEATURES]],
) {
    assert_eq!(d_features.len(), positions.len(), "encode_backward: gradients");
    assert_eq!(d_table.len(), level.entries, "encode_backward: table");
    #[cfg(target_arch = "x86_64")]
    if let Some(avx512) = Avx512::new() {
        return Simd::vectorize(avx512.0, EncodeBackward { level, positions, d_features, d_table, kernel: avx512 });
    }
    Arch::new().dispatch(EncodeBackward { level, positions, d_features, d_table, kernel: Portable });
}

struct EncodeBackward<'a, K> {
    level: &'a Level,
    positions: &'a Positions,
    d_features: &'a [[f32; FEATURES]],
    d_table: &'a mut [[f32; FEATURES]],
    kernel: K,
}

impl<K: Kernel> WithSimd for EncodeBackward<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (group, d_features) in self.d_features.chunks_exact(LANES).enumerate() {
            let corners = self.kernel.corners(self.level, self.positions.group(group));
            for (lane, d) in d_features.iter().enumerate() {
                for corner in 0..CORNERS {
                    let entry = &mut self.d_table[corners.entry[corner][lane] as usize];
                    let weight = corners.weight[corner][lane];
                    *entry = [d[0].mul_add(weight, entry[0]), d[1].mul_add(weight, entry[1])];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FieldConfig;
    use compute::rng::Rng;

    /// A dense, a hashed and a flat grid, with random entries and positions.
    fn example(extent: [f32; 3]) -> (Vec<Level>, Vec<Entry>, Positions) {
        let config =
            FieldConfig { levels: 4, log2_table: 10, finest_resolution: 64, base_resolution: 4, ..Default::default() };
        let levels = config.levels(extent);
        let rng = Rng::new(3, "hash test");
        let table = (0..levels.iter().map(|l| l.entries).sum::<usize>() as u64)
            .map(|i| [rng.normal(0, 2 * i), rng.normal(0, 2 * i + 1)].map(f16::from_f32))
            .collect();
        let mut positions = Positions::default();
        (0..30).for_each(|i| positions.push([0, 1, 2].map(|a| rng.uniform(1, 3 * i + a) * extent[a as usize])));
        positions.pad();
        (levels, table, positions)
    }

    #[test]
    fn a_position_on_a_vertex_reads_its_entry() {
        let (levels, table, _) = example([1.0; 3]);
        let level = &levels[0];
        assert!(level.dense);
        let vertex = [2u32, 1, 3];
        let mut positions = Positions::default();
        positions.push(vertex.map(|v| (v as f32 - 0.5) / level.scale));
        positions.pad();
        let mut out = vec![0.0; positions.len() * 16];
        encode(&levels, &table, &positions, &mut out, 16);
        let entry = table[(vertex[0] + 4 * (vertex[1] + 4 * vertex[2])) as usize].map(f32::from);
        assert!((out[0] - entry[0]).abs() < 1e-4 && (out[1] - entry[1]).abs() < 1e-4);
    }

    /// <d, encode(table)> is linear in the table: its gradient, times the table, gives it back.
    #[test]
    fn backward_is_the_adjoint_of_encode() {
        for extent in [[1.0; 3], [1.0, 0.3, 0.6]] {
            let (levels, table, positions) = example(extent);
            assert!(levels[0].dense && !levels[3].dense);
            let (rng, width) = (Rng::new(4, "adjoint"), 16);
            let mut out = vec![0.0; positions.len() * width];
            encode(&levels, &table, &positions, &mut out, width);
            for (l, level) in levels.iter().enumerate() {
                let d: Vec<[f32; 2]> =
                    (0..positions.len() as u64).map(|i| [rng.normal(0, i), rng.normal(1, i)]).collect();
                let mut d_table = vec![[0.0; 2]; level.entries];
                encode_backward(level, &positions, &d, &mut d_table);
                let dot = |a: &[f32; 2], b: &[f32]| f64::from(a[0] * b[0]) + f64::from(a[1] * b[1]);
                let left: f64 = d.iter().enumerate().map(|(i, d)| dot(d, &out[i * width + 2 * l..][..2])).sum();
                let right: f64 =
                    d_table.iter().zip(&table[level.offset..]).map(|(d, t)| dot(d, &t.map(f32::from))).sum();
                assert!((left - right).abs() < 1e-4 * left.abs().max(1.0), "level {l}: {left} {right}");
            }
        }
    }

    #[test]
    fn weights_of_a_cell_sum_to_one() {
        let (levels, _, positions) = example([1.0; 3]);
        for level in &levels {
            let corners = Portable.corners(level, positions.group(0));
            for lane in 0..LANES {
                let sum: f32 = corners.weight.iter().map(|weight| weight[lane]).sum();
                assert!((sum - 1.0).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn widening_is_exact_for_every_finite_half() {
        for bits in 0..=u16::MAX {
            let half = f16::from_bits(bits);
            assert!(!half.is_finite() || widen(half) == half.to_f32());
        }
    }

    /// Both kernels and both directions; 30 positions inside the box and two far outside.
    #[cfg(target_arch = "x86_64")]
    #[test]
    fn gathers_give_the_same_bits_as_single_look_ups() {
        let Some(avx512) = Avx512::new() else { return };
        for extent in [[1.0; 3], [1.0, 0.3, 0.6]] {
            let (levels, table, mut positions) = example(extent);
            positions.0.iter_mut().for_each(|axis| axis[30] = 7.5);
            for level in &levels {
                let table = &table[level.offset..level.offset + level.entries];
                for group in [0, 1].map(|group| positions.group(group)) {
                    assert_eq!(avx512.look_up(level, table, group), Portable.look_up(level, table, group));
                    let (wide, portable) = (avx512.corners(level, group), Portable.corners(level, group));
                    assert_eq!((wide.entry, wide.weight), (portable.entry, portable.weight));
                }
            }
        }
    }
}
