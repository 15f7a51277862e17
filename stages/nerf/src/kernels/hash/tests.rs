//! Look-ups and their gradients, on every kernel the machine has.

use super::*;
use crate::config::FieldConfig;
use crate::positions::Positions;
use compute::rng::Rng;

/// A dense, a hashed and a flat grid, with random entries and positions.
fn example(extent: [f32; 3]) -> (Vec<Level>, Vec<Entry>, Positions) {
    let config = FieldConfig {
        levels: 4,
        log2_table: 10,
        finest_resolution: 64,
        base_resolution: 4,
        ..Default::default()
    };
    let levels = config.levels(extent);
    let rng = Rng::new(3, "hash test");
    let table = (0..levels.iter().map(|l| l.entries).sum::<usize>() as u64)
        .map(|i| [rng.normal(0, 2 * i), rng.normal(0, 2 * i + 1)].map(f16::from_f32))
        .collect();
    let mut positions = Positions::default();
    (0..30).for_each(|i| {
        positions.push([0, 1, 2].map(|a| rng.uniform(1, 3 * i + a) * extent[a as usize]))
    });
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
    let mut out = vec![[0.0; 2]; positions.len()];
    encode(level, &table[..level.entries], positions.since(0), &mut out);
    let entry = table[(vertex[0] + 4 * (vertex[1] + 4 * vertex[2])) as usize].map(f32::from);
    assert!((out[0][0] - entry[0]).abs() < 1e-4 && (out[0][1] - entry[1]).abs() < 1e-4);
}

/// <d, encode(table)> is linear in the table: its gradient, times the table, gives it back.
#[test]
fn backward_is_the_adjoint_of_encode() {
    for extent in [[1.0; 3], [1.0, 0.3, 0.6]] {
        let (levels, table, positions) = example(extent);
        assert!(levels[0].dense && !levels[3].dense);
        let rng = Rng::new(4, "adjoint");
        for (l, level) in levels.iter().enumerate() {
            let table = &table[level.offset..level.offset + level.entries];
            let mut out = vec![[0.0; 2]; positions.len()];
            encode(level, table, positions.since(0), &mut out);
            let d: Vec<[f32; 2]> = (0..positions.len() as u64)
                .map(|i| [rng.normal(0, i), rng.normal(1, i)])
                .collect();
            let mut d_table = vec![[0.0; 2]; level.entries];
            encode_backward(level, positions.since(0), &d, &mut d_table);
            let dot = |a: &[f32; 2], b: &[f32]| f64::from(a[0] * b[0]) + f64::from(a[1] * b[1]);
            let left: f64 = d.iter().zip(&out).map(|(d, out)| dot(d, out)).sum();
            let right: f64 = d_table
                .iter()
                .zip(table)
                .map(|(d, t)| dot(d, &t.map(f32::from)))
                .sum();
            assert!(
                (left - right).abs() < 1e-4 * left.abs().max(1.0),
                "level {l}: {left} {right}"
            );
        }
    }
}

#[test]
fn weights_of_a_cell_sum_to_one() {
    let (levels, _, positions) = example([1.0; 3]);
    for level in &levels {
        let corners = Portable.corners(level, lanes(positions.since(0), 0));
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
            for group in [0, 1].map(|group| lanes(positions.since(0), group)) {
                assert_eq!(
                    avx512.look_up(level, table, group),
                    Portable.look_up(level, table, group)
                );
                let wide = avx512.corners(level, group);
                let portable = Portable.corners(level, group);
                assert_eq!((wide.entry, wide.weight), (portable.entry, portable.weight));
            }
        }
    }
}
