// From which optical depth on a cell is occupied: 0.01, or half the mean over the cells that are
// seen. One workgroup.
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> threshold: array<f32>;

var<workgroup> sums: array<vec2f, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) t: u32) {
    var sum = 0.0;
    var count = 0u;
    for (var i = t; i < p.cells; i += 256u) {
        if (values[i] >= 0.0) {
            sum += values[i];
            count++;
        }
    }
    sums[t] = vec2f(sum, f32(count));
    // Halves onto halves: the sum has one order.
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if (t < half) {
            sums[t] += sums[t + half];
        }
    }
    if (t == 0u) {
        // An even haze stays occupied, however thin it is.
        threshold[0] = min(0.01, 0.5 * sums[0].x / max(sums[0].y, 1.0));
    }
}
