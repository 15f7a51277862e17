// The second pass of the group normalisation's gradient, by the sums of the first.
@group(0) @binding(6) var<storage, read> chunk_sums: array<vec2f>;
@group(0) @binding(7) var<storage, read_write> out: array<f32>;

fn compute(group: vec3u, local: u32, first: u32, end: u32, start: u32, m: vec2f) {
    var sums = vec2f();
    for (var c = local; c < p.chunks; c += 256u) {
        sums += chunk_sums[group.y * p.chunks + c];
    }
    let along = sum_all(local, sums) / f32(p.size);
    for (var i = first + local; i < end; i += 256u) {
        let normal = (x[start + i] - m.x) * m.y;
        out[start + i] = m.y * fma(-normal, along.y, slope(group.y, start + i, i, m) - along.x);
    }
}
