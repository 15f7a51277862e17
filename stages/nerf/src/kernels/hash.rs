//! Trilinear look-up in the multiresolution hash grid, and its backward pass (Müller et al. 2022,
//! section 3). Knows nothing of rays or networks.
//!
//! Positions lie in unit space, in groups of [`LANES`]; callers pad. Entries are half-precision
//! numbers, so that a level stays in the second-level cache; sums are single-precision. With
//! AVX-512 the look-ups of a group are gathers ([`super::wide`]), elsewhere they are made one by
//! one; the bits are the same.

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

/// A table is fetched as a whole for at least one position per so many entries: for fewer, most
/// lines are not needed.
const ENTRIES_PER_POSITION: usize = 128;

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
    fn look_up(
        self,
        level: &Level,
        table: &[Entry],
        positions: [&[f32; LANES]; 3],
    ) -> [[f32; FEATURES]; LANES];
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
                // Half a cell's shift staggers the levels (instant-ngp); positions are never
                // negative.
                let x = positions[axis][lane] * level.scale + 0.5;
                // By way of i32, whose conversion is a vector instruction; u32's is not everywhere.
                cell[axis][lane] = x as i32 as u32;
                fraction[axis][lane] = x - (x as i32) as f32;
            }
        }
        let mut corners = Corners {
            entry: [[0; LANES]; CORNERS],
            weight: [[0.0; LANES]; CORNERS],
        };
        for corner in 0..CORNERS {
            let offset = [
                corner as u32 & 1,
                corner as u32 >> 1 & 1,
                corner as u32 >> 2,
            ];
            for lane in 0..LANES {
                corners.entry[corner][lane] = entry(
                    level,
                    [0, 1, 2].map(|a| cell[a][lane].wrapping_add(offset[a])),
                );
                let [x, y, z] = [0, 1, 2].map(|axis| {
                    let f = fraction[axis][lane];
                    if offset[axis] == 1 { f } else { 1.0 - f }
                });
                // The order of this product is a contract: the AVX-512 kernel has the same.
                corners.weight[corner][lane] = x * y * z;
            }
        }
        corners
    }

    #[inline(always)]
    fn look_up(
        self,
        level: &Level,
        table: &[Entry],
        positions: [&[f32; LANES]; 3],
    ) -> [[f32; FEATURES]; LANES] {
        let corners = self.corners(level, positions);
        std::array::from_fn(|lane| {
            let mut sum = [0f32; FEATURES];
            for corner in 0..CORNERS {
                let entry = table[corners.entry[corner][lane] as usize].map(widen);
                let weight = corners.weight[corner][lane];
                sum = [
                    entry[0].mul_add(weight, sum[0]),
                    entry[1].mul_add(weight, sum[1]),
                ];
            }
            sum
        })
    }
}

/// The entry of a vertex.
#[inline(always)]
pub fn entry(level: &Level, [x, y, z]: [u32; 3]) -> u32 {
    let [nx, ny, _] = level.resolution;
    let entries = level.entries as u32;
    if !level.dense {
        // Entries are a power of two, so the mask is the remainder.
        return (x ^ y.wrapping_mul(PRIMES[0]) ^ z.wrapping_mul(PRIMES[1])) & (entries - 1);
    }
    // A corner past the last vertex wraps into the next row, as in instant-ngp. What lies outside
    // the box stays harmless.
    let i = x.wrapping_add(nx.wrapping_mul(y.wrapping_add(ny.wrapping_mul(z))));
    // One subtraction in place of a remainder: below the end it wraps to a huge number.
    i.min(i.wrapping_sub(entries)).min(entries - 1)
}

/// A finite half as an f32, exactly: its exponent is moved, and the difference of the biases is
/// multiplied out.
#[inline(always)]
pub fn widen(half: f16) -> f32 {
    const BIAS: f32 = f32::from_bits((127 + 112) << 23);
    let bits = u32::from(half.to_bits());
    f32::from_bits((bits & 0x8000) << 16 | (bits & 0x7fff) << 13) * BIAS
}

/// The features of a level, whose entries `table` holds, at all positions.
pub fn encode(level: &Level, table: &[Entry], positions: [&[f32]; 3], out: &mut [[f32; FEATURES]]) {
    assert_eq!(out.len(), positions[0].len(), "encode: output size");
    assert_eq!(
        table.len(),
        level.entries,
        "encode: a table of another level"
    );
    // A level of 2^17 entries, half a megabyte, fits into the second-level cache, but Adam has
    // driven it out since the last step.
    // For few positions most of the table would be fetched for nothing.
    if positions[0].len() >= table.len() / ENTRIES_PER_POSITION {
        fetch(table);
    }
    #[cfg(target_arch = "x86_64")]
    if let Some(avx512) = Avx512::new() {
        return Simd::vectorize(
            avx512.0,
            Encode {
                level,
                table,
                positions,
                out,
                kernel: avx512,
            },
        );
    }
    Arch::new().dispatch(Encode {
        level,
        table,
        positions,
        out,
        kernel: Portable,
    });
}

/// Brings a table into the cache from front to back, as fast as memory gives: look-ups that miss
/// wait for every line.
fn fetch(table: &[Entry]) {
    let line = 64 / size_of::<Entry>();
    // Without it the compiler would drop reads whose sum nobody uses.
    std::hint::black_box(
        table
            .iter()
            .step_by(line)
            .fold(0, |sum, entry| sum ^ entry[0].to_bits()),
    );
}

struct Encode<'a, K> {
    level: &'a Level,
    table: &'a [Entry],
    positions: [&'a [f32]; 3],
    out: &'a mut [[f32; FEATURES]],
    kernel: K,
}

impl<K: Kernel> WithSimd for Encode<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (group, out) in self.out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            *out = self
                .kernel
                .look_up(self.level, self.table, lanes(self.positions, group));
        }
    }
}

/// A group's coordinates, one array per axis.
#[inline(always)]
fn lanes(positions: [&[f32]; 3], group: usize) -> [&[f32; LANES]; 3] {
    positions.map(|axis| &axis.as_chunks::<LANES>().0[group])
}

/// The backward pass of [`encode`]: adds to `d_table` from `d_features`, one pair per position.
/// Positions are taken in order, so the sums have one order.
pub fn encode_backward(
    level: &Level,
    positions: [&[f32]; 3],
    d_features: &[[f32; FEATURES]],
    d_table: &mut [[f32; FEATURES]],
) {
    assert_eq!(
        d_features.len(),
        positions[0].len(),
        "encode_backward: gradients"
    );
    assert_eq!(d_table.len(), level.entries, "encode_backward: table");
    #[cfg(target_arch = "x86_64")]
    if let Some(avx512) = Avx512::new() {
        return Simd::vectorize(
            avx512.0,
            EncodeBackward {
                level,
                positions,
                d_features,
                d_table,
                kernel: avx512,
            },
        );
    }
    Arch::new().dispatch(EncodeBackward {
        level,
        positions,
        d_features,
        d_table,
        kernel: Portable,
    });
}

struct EncodeBackward<'a, K> {
    level: &'a Level,
    positions: [&'a [f32]; 3],
    d_features: &'a [[f32; FEATURES]],
    d_table: &'a mut [[f32; FEATURES]],
    kernel: K,
}

impl<K: Kernel> WithSimd for EncodeBackward<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (group, d_features) in self.d_features.chunks_exact(LANES).enumerate() {
            let corners = self
                .kernel
                .corners(self.level, lanes(self.positions, group));
            // One position after the other: two of a group may share a vertex, and a scatter would
            // lose one of their sums.
            for (lane, d) in d_features.iter().enumerate() {
                for corner in 0..CORNERS {
                    let entry = &mut self.d_table[corners.entry[corner][lane] as usize];
                    let weight = corners.weight[corner][lane];
                    *entry = [
                        d[0].mul_add(weight, entry[0]),
                        d[1].mul_add(weight, entry[1]),
                    ];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
