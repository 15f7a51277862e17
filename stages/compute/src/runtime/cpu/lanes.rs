//! Reductions in a fixed number of lanes side by side, joined as a tree: the same bits whatever the
//! vectors' width. Written as `for` loops, which are sure to be inlined into the vectorised kernel;
//! iterators' `fold` is not.

/// Lanes of every reduction; a multiple of the widest vector, to hide the latency of its additions.
pub const LANES: usize = 64;

/// Joins the `WIDTH` lanes from `WIDTH` on to those before.
#[inline(always)]
fn halve<const ALL: usize, const WIDTH: usize>(
    lanes: &mut [f32; ALL],
    operation: &impl Fn(f32, f32) -> f32,
) {
    // By halves, so that a vector of any width joins whole vectors first.
    for i in 0..WIDTH {
        lanes[i] = operation(lanes[i], lanes[i + WIDTH]);
    }
}

/// Joins the lanes by halves.
#[inline(always)]
pub fn join(mut lanes: [f32; LANES], operation: impl Fn(f32, f32) -> f32) -> f32 {
    halve::<LANES, 32>(&mut lanes, &operation);
    halve::<LANES, 16>(&mut lanes, &operation);
    halve::<LANES, 8>(&mut lanes, &operation);
    halve::<LANES, 4>(&mut lanes, &operation);
    halve::<LANES, 2>(&mut lanes, &operation);
    halve::<LANES, 1>(&mut lanes, &operation);
    lanes[0]
}

/// The sum of `term` over `x`.
#[inline(always)]
pub fn sum(x: &[f32], term: impl Fn(f32) -> f32) -> f32 {
    let mut lanes = [0.0; LANES];
    // A length known when it is compiled, so that the loop becomes vectors; what is left comes
    // after.
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
    let xs = x.chunks_exact(LANES);
    let ys = y.chunks_exact(LANES);
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

/// Lanes of [`sums`], which has several rows of them, and is for short slices.
const FEW: usize = 16;

/// The sums of all `terms` over the triples of `x`, `y` and `z`, in one pass.
#[inline(always)]
pub fn sums<const N: usize>(
    x: &[f32],
    y: &[f32],
    z: &[f32],
    terms: impl Fn(f32, f32, f32) -> [f32; N],
) -> [f32; N] {
    let mut lanes = [[0.0; FEW]; N];
    let (xs, x) = x.as_chunks::<FEW>();
    let (ys, y) = y.as_chunks::<FEW>();
    let (zs, z) = z.as_chunks::<FEW>();
    for ((x, y), z) in xs.iter().zip(ys).zip(zs) {
        for lane in 0..FEW {
            let terms = terms(x[lane], y[lane], z[lane]);
            for i in 0..N {
                lanes[i][lane] += terms[i];
            }
        }
    }
    for (lane, ((x, y), z)) in x.iter().zip(y).zip(z).enumerate() {
        let terms = terms(*x, *y, *z);
        for i in 0..N {
            lanes[i][lane] += terms[i];
        }
    }
    for lanes in &mut lanes {
        halve::<FEW, 8>(lanes, &|a, b| a + b);
        halve::<FEW, 4>(lanes, &|a, b| a + b);
        halve::<FEW, 2>(lanes, &|a, b| a + b);
        halve::<FEW, 1>(lanes, &|a, b| a + b);
    }
    std::array::from_fn(|i| lanes[i][0])
}

/// The largest element; minus infinity if there is none.
#[inline(always)]
pub fn max(x: &[f32]) -> f32 {
    // Not `f32::max`, whose care for NaN takes several instructions.
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
