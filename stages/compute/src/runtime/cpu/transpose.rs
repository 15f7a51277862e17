//! Rows turned into columns. It knows where values lie, and nothing of what they mean.
#![allow(unsafe_code)]

use super::simd::Level;

/// Side of the square blocks that vectors turn at once.
const BLOCK: usize = 16;

/// Writes the `count` rows of `rows`, each of `depth` elements and `row_stride` apart, as the first
/// columns of `out`, whose `depth` rows are `out_stride` apart.
pub fn transpose_into(
    rows: &[f32],
    row_stride: usize,
    [count, depth]: [usize; 2],
    out: &mut [f32],
    out_stride: usize,
) {
    if count == 0 || depth == 0 {
        return;
    }
    assert!(
        (count - 1) * row_stride + depth <= rows.len(),
        "transpose: the rows reach beyond their values"
    );
    assert!(
        (depth - 1) * out_stride + count <= out.len(),
        "transpose: the columns reach beyond their values"
    );
    for row in (0..count).step_by(BLOCK) {
        for k in (0..depth).step_by(BLOCK) {
            let extent = [BLOCK.min(count - row), BLOCK.min(depth - k)];
            let from = &rows[row * row_stride + k..];
            let to = &mut out[k * out_stride + row..];
            match Level::current() {
                // SAFETY: the level is the processor's; the block lies within both, by the
                // assertions above.
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => unsafe {
                    turn(
                        from.as_ptr(),
                        row_stride,
                        extent,
                        to.as_mut_ptr(),
                        out_stride,
                    )
                },
                _ => turn_by_element(from, row_stride, extent, to, out_stride),
            }
        }
    }
}

fn turn_by_element(
    from: &[f32],
    row_stride: usize,
    [count, depth]: [usize; 2],
    to: &mut [f32],
    out_stride: usize,
) {
    for row in 0..count {
        for (k, value) in from[row * row_stride..][..depth].iter().enumerate() {
            to[k * out_stride + row] = *value;
        }
    }
}

/// Turns a block of at most 16 by 16 in four rounds: round s exchanges, between rows that differ in
/// bit s, the elements whose column differs in that bit. SAFETY: the processor has AVX-512, and the
/// block lies within both memories.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn turn(
    from: *const f32,
    row_stride: usize,
    [count, depth]: [usize; 2],
    to: *mut f32,
    out_stride: usize,
) {
    use std::arch::x86_64::*;

    /// Which of two rows' 32 lanes the lower (or the higher) of them takes.
    const fn choices(step: usize, high: bool) -> [i32; BLOCK] {
        let mut lanes = [0; BLOCK];
        let mut lane = 0;
        while lane < BLOCK {
            lanes[lane] = match (lane & step == 0, high) {
                (true, false) => lane,
                (true, true) => lane + step,
                (false, false) => BLOCK + lane - step,
                (false, true) => BLOCK + lane,
            } as i32;
            lane += 1;
        }
        lanes
    }

    /// One round. SAFETY: the processor has AVX-512.
    #[inline(always)]
    unsafe fn exchange<const STEP: usize>(rows: &mut [__m512; BLOCK]) {
        // SAFETY: by the contract of this function; the constants are as long as a vector.
        unsafe {
            let low = _mm512_loadu_si512(const { &choices(STEP, false) }.as_ptr().cast());
            let high = _mm512_loadu_si512(const { &choices(STEP, true) }.as_ptr().cast());
            for row in 0..BLOCK {
                if row & STEP == 0 {
                    let a = rows[row];
                    let b = rows[row + STEP];
                    rows[row] = _mm512_permutex2var_ps(a, low, b);
                    rows[row + STEP] = _mm512_permutex2var_ps(a, high, b);
                }
            }
        }
    }

    // For 16 the shift leaves bit 16, and less 1 all of the lower 16.
    let read = (1u32 << depth).wrapping_sub(1) as u16;
    let write = (1u32 << count).wrapping_sub(1) as u16;
    // SAFETY: masks and counts keep every access within the block.
    unsafe {
        let mut rows: [__m512; BLOCK] = std::array::from_fn(|row| {
            let read = if row < count { read } else { 0 };
            // Masked lanes touch no memory, so the pointer may lie beyond it.
            _mm512_maskz_loadu_ps(read, from.wrapping_add(row * row_stride))
        });
        exchange::<8>(&mut rows);
        exchange::<4>(&mut rows);
        exchange::<2>(&mut rows);
        exchange::<1>(&mut rows);
        for (k, row) in rows.iter().enumerate().take(depth) {
            _mm512_mask_storeu_ps(to.add(k * out_stride), write, *row);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_blocks_of_any_size() {
        for (count, depth) in [(1, 1), (16, 16), (17, 9), (5, 40), (32, 33)] {
            let stride = depth + 3;
            let out_stride = count + 2;
            let rows: Vec<f32> = (0..count * stride).map(|i| i as f32).collect();
            let mut out = vec![-1.0; depth * out_stride];
            transpose_into(&rows, stride, [count, depth], &mut out, out_stride);
            for (k, column) in out.chunks(out_stride).enumerate() {
                let expected: Vec<f32> = (0..count).map(|row| rows[row * stride + k]).collect();
                assert_eq!(
                    (&column[..count], &column[count..]),
                    (&expected[..], &[-1.0, -1.0][..]),
                    "{count}x{depth}"
                );
            }
        }
    }
}
