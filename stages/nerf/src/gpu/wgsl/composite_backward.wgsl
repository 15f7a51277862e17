// Compares pixels with the photos, and takes the gradient back along each ray to raw densities and
// colours. `pixels` holds of each: the colour it should have and the weight of its view; the
// background and the number of its rays.
@group(0) @binding(1) var<storage, read> rays: array<vec4f>;
@group(0) @binding(2) var<storage, read> before: array<u32>;
@group(0) @binding(3) var<storage, read> samples: array<vec4u>;
@group(0) @binding(4) var<storage, read> raw: array<vec4f>;
@group(0) @binding(5) var<storage, read> views: array<vec4f>;
@group(0) @binding(6) var<storage, read> pixels: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> d_raw: array<vec4f>;
// The loss with the view's weight, and the squared error without, summed over the channels of a
// pixel.
@group(0) @binding(8) var<storage, read_write> losses: array<vec2f>;

struct Gradient {
    rgb: vec3f,
    transmittance: f32,
}

fn sum_of(x: vec3f) -> f32 {
    return x.x + x.y + x.z;
}

// The gradient to what a ray sees. A pixel is the mean of its rays, of which `at` is the number of
// this one.
fn compare(ray: u32, pixel: u32, at: u32) -> Gradient {
    let wanted = pixels[2u * pixel];
    let background = pixels[2u * pixel + 1u].xyz;
    let count = u32(pixels[2u * pixel + 1u].w);
    let share = 1.0 / f32(count);
    var sum = vec3f();
    // Every ray of a pixel works its colour out again, in one order.
    for (var other = ray - at; other < ray - at + count; other++) {
        let view = views[2u * other];
        sum += view.xyz + view.w * background;
    }
    let residual = share * sum - wanted.xyz;
    // The first ray of a pixel speaks for it.
    if (at == 0u) {
        let size = abs(residual);
        let loss = select(size - 0.5 * p.beta, 0.5 * size * size / p.beta, size < vec3f(p.beta));
        losses[pixel] = vec2f(wanted.w * sum_of(loss), sum_of(residual * residual));
    }
    let slope = clamp(residual / p.beta, vec3f(-1.0), vec3f(1.0));
    let d = wanted.w * share * slope / (3.0 * f32(p.pixels));
    // A pixel shows rgb + T background.
    return Gradient(d, sum_of(d * background));
}

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= p.rays) {
        return;
    }
    let ray = p.first + id.x;
    let notes = rays[4u * ray + 2u];
    let pixel = u32(notes.y);
    let d = compare(ray, pixel, u32(notes.z));
    let first = before[id.x];
    let end = before[id.x + 1u];
    let start = rays[4u * ray].w;
    let range = rays[4u * ray + 1u].w - start;
    // The strengths per ray, so that their sum over a batch does not depend on its size.
    let per_ray = 1.0 / (f32(p.pixels) * pixels[2u * pixel + 1u].w);

    var total = 0.0;
    var moment = 0.0;
    for (var i = first; i < end; i++) {
        let weight = bitcast<f32>(samples[1u + i].w);
        total += weight;
        moment += weight * (bitcast<f32>(samples[1u + i].x) - start) / range;
    }
    // By weight, with the distortion loss of Barron et al. 2022 (equation 15); and by colour.
    var total_before = 0.0;
    var moment_before = 0.0;
    for (var i = first; i < end; i++) {
        let sample = samples[1u + i];
        let weight = bitcast<f32>(sample.w);
        let s = (bitcast<f32>(sample.x) - start) / range;
        let ds = bitcast<f32>(sample.y) / range;
        // Running sums make the double sum over pairs linear, as on the CPU.
        let behind = total - total_before - weight;
        let moment_behind = moment - moment_before - weight * s;
        let distance = s * (total_before - behind) - (moment_before - moment_behind);
        total_before += weight;
        moment_before += weight * s;
        let color = vec3f(logistic(raw[i].y), logistic(raw[i].z), logistic(raw[i].w));
        let by_weight = sum_of(d.rgb * color) + p.distortion * per_ray * 2.0 * (distance + weight * ds / 3.0);
        d_raw[i] = vec4f(by_weight, d.rgb * weight * color * (1.0 - color));
    }
    // By density, from the back: both the transmittance and the sum over what lies behind are
    // gathered on the way.
    var transmittance = views[2u * ray].w;
    var behind = transmittance * d.transmittance;
    for (var i = end; i > first; i--) {
        let sample = samples[i];
        let weight = bitcast<f32>(sample.w);
        let by_weight = d_raw[i - 1u].x;
        var by_raw = bitcast<f32>(sample.y) * (transmittance * by_weight - behind) * density_slope(raw[i - 1u].x);
        behind += weight * by_weight;
        transmittance += weight;
        if ((bitcast<f32>(sample.x) - start) / range < p.fog_range && raw[i - 1u].x > -10.0) {
            by_raw += p.fog * per_ray;
        }
        d_raw[i - 1u].x = by_raw;
    }
}
