// The first pass of the group normalisation's gradient: sums over a chunk of what the second takes
// away.
@group(0) @binding(6) var<storage, read_write> out: array<vec2f>;

fn compute(group: vec3u, local: u32, first: u32, end: u32, start: u32, m: vec2f) {
    var sums = vec2f();
    for (var i = first + local; i < end; i += 256u) {
        let d = slope(group.y, start + i, i, m);
        sums = vec2f(sums.x + d, fma(d * (x[start + i] - m.x), m.y, sums.y));
    }
    let all = sum_all(local, sums);
    if (local == 0u) {
        out[group.y * p.chunks + group.x] = all;
    }
}
