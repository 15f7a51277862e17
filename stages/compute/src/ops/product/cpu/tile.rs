//! The innermost loop of every product: one tile of the result, whose sums stay in registers.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{__m256, __m512};

use crate::runtime::cpu::matrix::{Matrix, MatrixMut};
use crate::runtime::cpu::simd::Level;
#[cfg(target_arch = "x86_64")]
use crate::runtime::cpu::vector::Dots;
use crate::runtime::cpu::vector::{Lanes, Pairs, Vector};
use crate::runtime::format::Precision;

/// Rows of the largest tile: two vectors of AVX-512 for each are 24 sums, which leave registers for
/// two vectors of the panel and one number of the left factor.
pub const ROWS: usize = 12;
/// Columns of a tile, and of a packed panel.
pub const COLUMNS: usize = 32;

/// Terms that are summed one after the other before they join the total: sums of short sums round
/// less than one long sum does, here by more than half.
const CHAIN: usize = 32;

/// What becomes of the values that a product finds in its result.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Old {
    /// The product is added to them.
    Keep,
    /// The product replaces them.
    Forget,
}

/// Writes `a` times `panel` to `out`, which has at most [`ROWS`] rows and [`COLUMNS`] columns. A
/// panel is packed: its rows have [`COLUMNS`] elements, one after the other, whatever `out` has. In
/// bf16, `a` and `panel` hold [pairs](super::bf16::pair).
#[inline(always)]
pub fn multiply_tile(
    out: &mut MatrixMut,
    a: Matrix,
    panel: &[f32],
    (old, precision): (Old, Precision),
) {
    let rows = out.rows();
    let columns = out.columns();
    let depth = a.columns;
    assert!(
        rows <= ROWS && columns <= COLUMNS && a.rows == rows,
        "tile: the extents disagree"
    );
    assert!(
        panel.len() >= depth * COLUMNS,
        "tile: the panel is too short"
    );
    // A narrow tile is computed whole beside the result: its sums have the same order as all
    // others.
    if rows > 0 && columns == COLUMNS {
        // SAFETY: the extents of all three have just been checked.
        return unsafe {
            dispatch(
                depth,
                a,
                panel.as_ptr(),
                out.start(),
                out.row_stride(),
                (old, precision),
            )
        };
    }
    let mut whole = [0.0; ROWS * COLUMNS];
    // SAFETY: as above; `whole` has room for the largest tile.
    unsafe {
        dispatch(
            depth,
            a,
            panel.as_ptr(),
            whole.as_mut_ptr(),
            COLUMNS,
            (Old::Forget, precision),
        )
    };
    for (row, sums) in whole.chunks(COLUMNS).enumerate().take(rows) {
        for (out, sum) in out.row(row).iter_mut().zip(sums) {
            *out = if old == Old::Keep { *out + sum } else { *sum };
        }
    }
}

/// SAFETY: `panel` holds `depth` rows, and `out` has as many rows as `a`, of [`COLUMNS`] elements
/// each.
#[inline(always)]
unsafe fn dispatch(
    depth: usize,
    a: Matrix,
    panel: *const f32,
    out: *mut f32,
    stride: usize,
    (old, precision): (Old, Precision),
) {
    // SAFETY: by the contract of this function; a level is current only if the processor has it.
    unsafe {
        match precision {
            #[cfg(target_arch = "x86_64")]
            Precision::Bf16 if Level::current().has_bf16_dot() => {
                avx512_bf16(depth, a, panel, out, stride, old)
            }
            #[cfg(target_arch = "x86_64")]
            Precision::F32 if Level::current() == Level::Avx512 => {
                avx512(depth, a, panel, out, stride, old)
            }
            #[cfg(target_arch = "x86_64")]
            Precision::Bf16 if Level::current() >= Level::Avx2 => {
                avx2::<Pairs<__m256>>(depth, a, panel, out, stride, old)
            }
            #[cfg(target_arch = "x86_64")]
            Precision::F32 if Level::current() == Level::Avx2 => {
                avx2::<__m256>(depth, a, panel, out, stride, old)
            }
            Precision::Bf16 => split::<Pairs<Lanes>>(depth, a, panel, out, stride, old),
            Precision::F32 => split::<Lanes>(depth, a, panel, out, stride, old),
        }
    }
}

/// SAFETY: that of [`dispatch`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512bw")]
unsafe fn avx512(
    depth: usize,
    a: Matrix,
    panel: *const f32,
    out: *mut f32,
    stride: usize,
    old: Old,
) {
    // SAFETY: by the contract of this function.
    unsafe { split::<__m512>(depth, a, panel, out, stride, old) }
}

/// SAFETY: that of [`dispatch`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512bf16")]
unsafe fn avx512_bf16(
    depth: usize,
    a: Matrix,
    panel: *const f32,
    out: *mut f32,
    stride: usize,
    old: Old,
) {
    // SAFETY: by the contract of this function.
    unsafe { split::<Dots>(depth, a, panel, out, stride, old) }
}

/// SAFETY: that of [`dispatch`]; `V` is a vector of AVX2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2<V: Vector>(
    depth: usize,
    a: Matrix,
    panel: *const f32,
    out: *mut f32,
    stride: usize,
    old: Old,
) {
    // SAFETY: by the contract of this function.
    unsafe { split::<V>(depth, a, panel, out, stride, old) }
}

/// Cuts the tile into parts that fit the registers.
/// SAFETY: that of [`dispatch`]; inlined where the vector's instructions may be used.
#[inline(always)]
unsafe fn split<V: Vector>(
    depth: usize,
    a: Matrix,
    panel: *const f32,
    out: *mut f32,
    stride: usize,
    old: Old,
) {
    for row in (0..a.rows).step_by(V::TALL) {
        for column in (0..COLUMNS).step_by(2 * V::LANES) {
            // SAFETY: the offsets lie within the tile and the panel.
            unsafe {
                let a_start = a.values().as_ptr().add(row * a.row_stride);
                let strides = [a.row_stride, a.column_stride];
                let panel = panel.add(column);
                let out = out.add(row * stride + column);
                macro_rules! rows {
                    ($($rows:literal)*) => {
                        match V::TALL.min(a.rows - row) {
                            $($rows => sum::<V, $rows>(depth, a_start, strides, panel, out, stride, old),)*
                            _ => (),
                        }
                    };
                }
                rows!(1 2 3 4 5 6 7 8 9 10 11 12);
            }
        }
    }
}

/// Writes `R` rows of `a` times two vectors' width of the panel to `out`.
/// SAFETY: that of [`split`].
#[inline(always)]
unsafe fn sum<V: Vector, const R: usize>(
    depth: usize,
    a: *const f32,
    [row_stride, step]: [usize; 2],
    panel: *const f32,
    out: *mut f32,
    stride: usize,
    old: Old,
) {
    // SAFETY: by the contract of this function.
    unsafe {
        let mut totals = [[V::splat(0.0); 2]; R];
        // A pointer a row, so that the loop adds one offset to each.
        let rows: [*const f32; R] = std::array::from_fn(|row| a.add(row * row_stride));
        for first in (0..depth).step_by(CHAIN) {
            let mut sums = [[V::splat(0.0); 2]; R];
            for k in first..depth.min(first + CHAIN) {
                let b = [
                    V::load(panel.add(k * COLUMNS)),
                    V::load(panel.add(k * COLUMNS + V::LANES)),
                ];
                for (row, sums) in rows.iter().zip(&mut sums) {
                    let a = V::splat(*row.add(k * step));
                    sums[0] = a.multiply_add(b[0], sums[0]);
                    sums[1] = a.multiply_add(b[1], sums[1]);
                }
            }
            for (totals, sums) in totals.iter_mut().zip(&sums) {
                *totals = [totals[0].add(sums[0]), totals[1].add(sums[1])];
            }
        }
        for (row, totals) in totals.iter().enumerate() {
            for (i, sum) in totals.iter().enumerate() {
                let out = out.add(row * stride + i * V::LANES);
                (if old == Old::Keep {
                    sum.add(V::load(out))
                } else {
                    *sum
                })
                .store(out);
            }
        }
    }
}
