//! Reductions in a fixed number of lanes side by side, joined as a tree: the same bits whatever the vectors' width.
//! Written as `for` loops, which are sure to be inlined into the vectorised kernel; iterators' `fold` is not.

/// Lanes of every reduction; a multiple of the widest vector, to hide the latency of its additions.
pub const LANES: usize = 64;

/// Joins the lanes by halves.
#[inline(always)]
pub fn join(mut lanes: [f32; LANES], operation: impl Fn(f32, f32) -> f32) -> f32 {
    #[inline(always)]
    fn halve<const WIDTH: usize>(lanes: &mut [f32; LANES], operation: &impl Fn(f32, f32) -> f32) {
        for i in 0..WIDTH {
            lanes[i] = operation(lanes[i], lanes[i + WIDTH]);
        }
    }
    halve::<32>(&mut lanes, &operation);
    halve::<16>(&mut lanes, &operation);
    halve::<8>(&mut lanes, &operation);
    halve::<4>(&mut lanes, &operation);
    halve::<2>(&mut lanes, &operation);
    halve::<1>(&mut lanes, &operation);
    lanes[0]
}

/// The sum of `term` over `x`.
#[inline(always)]
pub fn sum(x: &[f32], term: impl Fn(f32) -> f32) -> f32 {
    let mut lanes = [0.0; LANES];
    let chunks = x.chunks_exact(LANES);
    let rest = chunks.remainder();
    for x in chunks {
        for (lane, &x) in lanes.iter_mut().zip(x) {
            *lane += term(x);
        }
    }
    for (lane, &x) in lanes.iter_mut().zip(rest) {
        *lane += term(x);
    }
    join(lanes, |a, b| a + b)
}

/// The sum of `term` over the pairs of `x` and `y`.
#[inline(always)]
pub fn sum_pairs(x: &[f32], y: &[f32], term: impl Fn(f32, f32) -> f32) -> f32 {
    let mut lanes = [0.0; LANES];
    let (xs, ys) = (x.chunks_exact(LANES), y.chunks_exact(LANES));
    let rest = xs.remainder().iter().zip(ys.remainder());
    for (x, y) in xs.zip(ys) {
        for ((lane, &x), &y) in lanes.iter_mut().zip(x).zip(y) {
            *lane += term(x, y);
        }
    }
    for (lane, (&x, &y)) in lanes.iter_mut().zip(rest) {
        *lane += term(x, y);
    }
    join(lanes, |a, b| a + b)
}

/// The largest element; minus infinity if there is none.
#[inline(always)]
pub fn max(x: &[f32]) -> f32 {
    let larger = |a: f32, b: f32| if b > a { b } else { a };
    let mut lanes = [f32::NEG_INFINITY; LANES];
    let chunks = x.chunks_exact(LANES);
    let rest = chunks.remainder();
    for x in chunks {
        for (lane, &x) in lanes.iter_mut().zip(x) {
            *lane = larger(*lane, x);
        }
    }
    for (lane, &x) in lanes.iter_mut().zip(rest) {
        *lane = larger(*lane, x);
    }
    join(lanes, larger)
}

/// Replaces every element by `change` of it, and sums the results.
#[inline(always)]
pub fn change_and_sum(x: &mut [f32], change: impl Fn(f32) -> f32) -> f32 {
    let mut lanes = [0.0; LANES];
    let mut chunks = x.chunks_exact_mut(LANES);
    for x in &mut chunks {
        for (lane, x) in lanes.iter_mut().zip(x) {
            *x = change(*x);
            *lane += *x;
        }
    }
    for (lane, x) in lanes.iter_mut().zip(chunks.into_remainder()) {
        *x = change(*x);
        *lane += *x;
    }
    join(lanes, |a, b| a + b)
}
