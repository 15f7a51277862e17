// The mean, and the sum of squares about it, of a chunk of 4096 elements of a group.
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<vec2f>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let first = group.x * 4096u;
    let end = min(first + 4096u, p.size);
    let start = group.y * p.size;
    var sum = 0.0;
    for (var i = first + local; i < end; i += 256u) {
        sum += x[start + i];
    }
    let mean = sum_all(local, vec2f(sum, 0.0)).x / f32(end - first);
    // About the mean: what is left of E[x^2] - mean^2 where the mean is large is rounding.
    var square = 0.0;
    for (var i = first + local; i < end; i += 256u) {
        let d = x[start + i] - mean;
        square = fma(d, d, square);
    }
    let about = sum_all(local, vec2f(square, 0.0)).x;
    if (local == 0u) {
        out[group.y * p.chunks + group.x] = vec2f(mean, about);
    }
}
