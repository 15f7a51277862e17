// What each ray sees: emission and absorption from front to back. Notes every sample's weight with
// it.
@group(0) @binding(1) var<storage, read> before: array<u32>;
@group(0) @binding(2) var<storage, read> raw: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> samples: array<vec4u>;
// Colour without background and transmittance; then the weighted distance.
@group(0) @binding(4) var<storage, read_write> views: array<vec4f>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= p.rays) {
        return;
    }
    var rgb = vec3f();
    var distance = 0.0;
    var transmittance = 1.0;
    // `before` and the samples begin anew with each pass, rays and views go on through the batch.
    for (var i = before[id.x]; i < before[id.x + 1u]; i++) {
        let sample = samples[1u + i];
        let x = raw[i];
        let next = transmittance * exponential(-density_of(x.x) * bitcast<f32>(sample.y));
        // As on the CPU: weights and the rest add up to 1 but for rounding.
        let weight = transmittance - next;
        transmittance = next;
        distance += weight * bitcast<f32>(sample.x);
        rgb += weight * vec3f(logistic(x.y), logistic(x.z), logistic(x.w));
        samples[1u + i].w = bitcast<u32>(weight);
    }
    let ray = p.first + id.x;
    views[2u * ray] = vec4f(rgb, transmittance);
    views[2u * ray + 1u] = vec4f(distance, 0.0, 0.0, 0.0);
}
