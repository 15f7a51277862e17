// A row of `width` elements per workgroup, normalised, scaled and shifted; or the gradient of that,
// with `dy`. A compiler may join a product and a sum into one operation, or not. On an NVIDIA H200 it chose otherwise for arrays
// in pieces than for whole ones, and the bits differed. `fma` leaves it no choice, here and in the group norms.
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read> gamma: array<f32>;
// The shift, or the gradient to the output.
@group(0) @binding(3) var<storage, read> other: array<f32>;
@group(0) @binding(4) var<storage, read_write> out: array<f32>;

fn moments(start: u32, local: u32) -> vec2f {
    let count = f32(p.width);
    var sum = 0.0;
    for (var i = local; i < p.width; i += 256u) {
        sum += x[start + i];
    }
    let mean = sum_all(local, vec2f(sum, 0.0)).x / count;
    // About the mean: what is left of E[x^2] - mean^2 where the mean is large is rounding.
    var square = 0.0;
    for (var i = local; i < p.width; i += 256u) {
        let d = x[start + i] - mean;
        square = fma(d, d, square);
    }
    let variance = sum_all(local, vec2f(square, 0.0)).x / count;
    return vec2f(mean, 1.0 / sqrt(variance + p.eps));
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let row = group.y * groups.x + group.x;
    if (row >= p.rows) {
        return;
    }
    let start = row * p.width;
    let m = moments(start, local);
#for once ${FORWARD}
    for (var i = local; i < p.width; i += 256u) {
        out[start + i] = fma((x[start + i] - m.x) * m.y, gamma[i], other[i]);
    }
#end
#for once ${BACKWARD}
    var sums = vec2f();
    for (var i = local; i < p.width; i += 256u) {
        let d = other[start + i] * gamma[i];
        sums = vec2f(sums.x + d, fma(d * (x[start + i] - m.x), m.y, sums.y));
    }
    let along = sum_all(local, sums) / f32(p.width);
    for (var i = local; i < p.width; i += 256u) {
        let normal = (x[start + i] - m.x) * m.y;
        out[start + i] = m.y * fma(-normal, along.y, fma(other[start + i], gamma[i], -along.x));
    }
#end
}
