//! Moving values around.

use std::ops::Range;

use crate::runtime::cpu::buffer::HostBuffer;
use crate::runtime::cpu::chunks::{CHUNK, fill};
use crate::runtime::cpu::transpose::transpose_into;
use crate::runtime::cpu::values::Values;

/// Columns that one task of a transpose turns into rows.
const BLOCK: usize = 32;

/// Joins `outer` rows of every part; a part is its values with the length of its rows.
pub fn concat(parts: &[(&[f32], usize)], outer: usize) -> HostBuffer {
    let row: usize = parts.iter().map(|(_, len)| len).sum();
    let mut out = HostBuffer::uninitialised(outer * row);
    // `chunks_mut` refuses 0, which the length of an empty array's rows is.
    for (i, mut out) in out.chunks_mut(row.max(1)).enumerate() {
        for (values, len) in parts {
            let (part, rest) = out.split_at_mut(*len);
            copy(&values[i * len..(i + 1) * len], part);
            out = rest;
        }
    }
    out
}

/// The part `range` of each of `outer` rows of `row` elements.
pub fn slice(x: &[f32], outer: usize, row: usize, range: Range<usize>) -> HostBuffer {
    let mut out = HostBuffer::uninitialised(outer * range.len());
    for (i, out) in out.chunks_mut(range.len().max(1)).enumerate() {
        copy(&x[i * row..][range.clone()], out);
    }
    out
}

fn copy(from: &[f32], to: &mut [f32]) {
    // By chunks, since a single image is often a single row: all threads share it.
    fill(to, CHUNK, |i, to| {
        to.copy_from_slice(&from[i * CHUNK..][..to.len()])
    });
}

/// Each of `batch` matrices `[rows, columns]` as `[columns, rows]`.
pub fn transpose(x: &[f32], batch: usize, rows: usize, columns: usize) -> HostBuffer {
    let mut out = HostBuffer::uninitialised(batch * rows * columns);
    if rows == 0 || columns == 0 {
        return out;
    }
    for (x, out) in x.chunks(rows * columns).zip(out.chunks_mut(rows * columns)) {
        fill(out, BLOCK * rows, |block, out| {
            let first = block * BLOCK;
            transpose_into(&x[first..], columns, [rows, out.len() / rows], out, rows);
        });
    }
    out
}

/// Every pixel repeated `factor` times both ways; `[planes, h, w]` is the extent of `x`.
pub fn upsample(x: &[f32], [planes, h, w]: [usize; 3], factor: usize) -> HostBuffer {
    let wide = w * factor;
    let mut out = HostBuffer::uninitialised(planes * h * factor * wide);
    fill(&mut out, (h * factor * wide).max(1), |plane, out| {
        let rows = x[plane * h * w..].chunks(w.max(1));
        for (out, x) in out.chunks_mut(factor * wide).zip(rows) {
            let (first, copies) = out.split_at_mut(wide);
            repeat_each(x, factor, first);
            copies
                .chunks_mut(wide)
                .for_each(|copy| copy.copy_from_slice(first));
        }
    });
    out
}

/// Every element `factor` times. Twice, as networks do, is a loop of its own: it vectorises.
fn repeat_each(x: &[f32], factor: usize, out: &mut [f32]) {
    if factor == 2 {
        let pairs = out.as_chunks_mut::<2>().0;
        pairs
            .iter_mut()
            .zip(x)
            .for_each(|(pair, &x)| *pair = [x, x]);
    } else {
        out.chunks_mut(factor)
            .zip(x)
            .for_each(|(out, &x)| out.fill(x));
    }
}

/// The sum over every block of `factor` by `factor`; `[planes, h, w]` is the extent of the result.
pub fn upsample_backward(dy: &[f32], [planes, h, w]: [usize; 3], factor: usize) -> HostBuffer {
    let wide = w * factor;
    let mut out = HostBuffer::zeros(planes * h * w);
    fill(&mut out, w.max(1), |i, out| {
        for dy in dy[i * factor * wide..(i + 1) * factor * wide].chunks(wide) {
            out.iter_mut()
                .zip(dy.chunks(factor))
                .for_each(|(out, dy)| *out += dy.iter().sum::<f32>());
        }
    });
    out
}

/// Every `factor * factor` planes laid out as one of blocks; `[planes, h, w]` are the planes of the
/// result, and the extents of one before.
pub fn shuffle(x: &[f32], [planes, h, w]: [usize; 3], factor: usize) -> HostBuffer {
    let wide = w * factor;
    let mut out = HostBuffer::uninitialised(planes * h * factor * wide);
    fill(&mut out, wide.max(1), |row, out| {
        let plane = row / (h * factor);
        let y = row % (h * factor);
        for column in 0..factor {
            let source = (plane * factor + y % factor) * factor + column;
            let x = &x[(source * h + y / factor) * w..][..w];
            out[column..]
                .iter_mut()
                .step_by(factor)
                .zip(x)
                .for_each(|(out, x)| *out = *x);
        }
    });
    out
}

/// The inverse of [`shuffle`]; `[planes, h, w]` are the planes of `x`, and the extents of one
/// afterwards.
pub fn unshuffle(x: &[f32], [planes, h, w]: [usize; 3], factor: usize) -> HostBuffer {
    let wide = w * factor;
    let mut out = HostBuffer::uninitialised(planes * h * factor * wide);
    fill(&mut out, w.max(1), |row, out| {
        let plane = row / h;
        let y = row % h;
        let source = plane / (factor * factor);
        let line = plane / factor % factor;
        let column = plane % factor;
        let x = &x[(source * h * factor + y * factor + line) * wide..][..wide];
        out.iter_mut()
            .zip(x[column..].iter().step_by(factor))
            .for_each(|(out, x)| *out = *x);
    });
    out
}

/// Mirrors an index at the first and last of `len` pixels.
fn mirrored(index: usize, before: usize, len: usize) -> usize {
    let distance = index.abs_diff(before);
    if index < before || distance < len {
        distance
    } else {
        // The edge pixel itself is not repeated.
        2 * (len - 1) - distance
    }
}

/// `[planes, h, w]` continued by mirroring, `[top, bottom, left, right]` pixels wide.
pub fn pad_reflect(
    x: &[f32],
    [planes, h, w]: [usize; 3],
    [top, bottom, left, right]: [usize; 4],
) -> HostBuffer {
    let height = top + h + bottom;
    let width = left + w + right;
    let mut out = HostBuffer::uninitialised(planes * height * width);
    fill(&mut out, width.max(1), |i, out| {
        let row = &x[(i / height * h + mirrored(i % height, top, h)) * w..][..w];
        out.iter_mut()
            .enumerate()
            .for_each(|(j, out)| *out = row[mirrored(j, left, w)]);
    });
    out
}

/// Row `id` of the table for every id.
pub fn gather_rows(table: Values, depth: usize, ids: &[u32]) -> HostBuffer {
    let mut out = HostBuffer::uninitialised(ids.len() * depth);
    out.chunks_mut(depth.max(1))
        .zip(ids)
        .for_each(|(out, &id)| table.widen(id as usize * depth, out));
    out
}
