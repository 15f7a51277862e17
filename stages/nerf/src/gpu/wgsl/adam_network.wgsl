// Joins the parts of the gradient to the networks' weights in their order and takes a step down.
// Writes the matrices both ways round.
@group(0) @binding(1) var<storage, read> parts: array<f32>;
@group(0) @binding(2) var<storage, read> stats: array<u32>;
@group(0) @binding(3) var<storage, read_write> weights: array<f32>;
@group(0) @binding(4) var<storage, read_write> moments: array<f32>;

// Where a weight at `i` of its matrix of INPUTS rows and OUTPUTS columns lies in the matrix turned
// over.
fn turned(i: u32, inputs: u32, outputs: u32) -> u32 {
    return i % outputs * inputs + i / outputs;
}

fn place_turned(i: u32) -> u32 {
    if (i < W1) {
        return T0 + turned(i, ENCODING, 64u);
    }
    if (i < W2) {
        return T1 + turned(i - W1, 64u, 16u);
    }
    if (i < W3) {
        return T2 + turned(i - W2, 32u, 64u);
    }
    if (i < W4) {
        return T3 + turned(i - W3, 64u, 64u);
    }
    return T4 + turned(i - W4, 64u, 16u);
}

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let i = id.x;
    if (i >= WEIGHTS || !is_finite(stats[0])) {
        return;
    }
    var gradient = 0.0;
    // In one order, so that the sum has the same bits every time.
    for (var part = 0u; part < p.parts; part++) {
        gradient += parts[part * WEIGHTS + i];
    }
    gradient += p.l2 * weights[i];
    let new_one = descend(Moments(weights[i], moments[i], moments[WEIGHTS + i]), gradient, p.rate);
    weights[i] = new_one.value;
    // Behind all straight matrices: no two invocations write to one place.
    weights[place_turned(i)] = new_one.value;
    moments[i] = new_one.first;
    moments[WEIGHTS + i] = new_one.second;
}
