// The gradient to a normalised value, which both passes of the group normalisation's gradient need.
@group(0) @binding(5) var<storage, read> dy: array<f32>;

// The gradient to the normalised value.
fn slope(which: u32, at: u32, i: u32, m: vec2f) -> f32 {
    let c = channel(which, i);
    return dy[at] * activation_slope(fma((x[at] - m.x) * m.y, gamma[c], beta[c])) * gamma[c];
}
