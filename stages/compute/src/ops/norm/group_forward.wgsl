// The second pass of the group normalisation: values, by the moments that the first has found.
@group(0) @binding(5) var<storage, read_write> out: array<f32>;

fn compute(group: vec3u, local: u32, first: u32, end: u32, start: u32, m: vec2f) {
    for (var i = first + local; i < end; i += 256u) {
        let c = channel(group.y, i);
        out[start + i] = activate(fma((x[start + i] - m.x) * m.y, gamma[c], beta[c]));
    }
}
