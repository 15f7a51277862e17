// A chunk of 4096 elements of a group per workgroup: normalised, scaled, shifted and activated; the
// sums that the gradient needs of it; or the gradient. The moments of the chunks are joined as Chan,
// Golub and LeVeque do (1979), by each workgroup anew, since they cannot wait for each other.
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read> gamma: array<f32>;
@group(0) @binding(3) var<storage, read> beta: array<f32>;
@group(0) @binding(4) var<storage, read> chunk_moments: array<vec2f>;

// Mean and reciprocal standard deviation of the group.
fn moments(which: u32, local: u32) -> vec2f {
    var sum = 0.0;
    for (var c = local; c < p.chunks; c += 256u) {
        sum = fma(chunk_moments[which * p.chunks + c].x, f32(min(4096u, p.size - c * 4096u)), sum);
    }
    let mean = sum_all(local, vec2f(sum, 0.0)).x / f32(p.size);
    var square = 0.0;
    for (var c = local; c < p.chunks; c += 256u) {
        let m = chunk_moments[which * p.chunks + c];
        let d = m.x - mean;
        // Chan et al.: squares about the chunk's own mean, and what moves them to the common one.
        square += fma(d * d, f32(min(4096u, p.size - c * 4096u)), m.y);
    }
    let variance = sum_all(local, vec2f(square, 0.0)).x / f32(p.size);
    return vec2f(mean, 1.0 / sqrt(variance + p.eps));
}

fn channel(which: u32, i: u32) -> u32 {
    return which % p.groups * p.channels + i / p.plane;
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let first = group.x * 4096u;
    let end = min(first + 4096u, p.size);
    let start = group.y * p.size;
    let m = moments(group.y, local);
    compute(group, local, first, end, start, m);
}
