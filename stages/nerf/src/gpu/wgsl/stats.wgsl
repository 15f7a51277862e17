// What a batch came to: the loss and the squared error, and how many samples were seen and looked
// at. One workgroup.
@group(0) @binding(1) var<storage, read> losses: array<vec2f>;
@group(0) @binding(2) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read> looked: array<u32>;
@group(0) @binding(4) var<storage, read_write> stats: array<u32>;

var<workgroup> sums: array<vec2f, 256>;
var<workgroup> counts: array<vec2u, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) t: u32) {
    var sum = vec2f();
    for (var i = t; i < p.pixels; i += 256u) {
        sum += losses[i];
    }
    var count = vec2u();
    for (var i = t; i < p.rays; i += 256u) {
        count += vec2u(seen[i], looked[i]);
    }
    sums[t] = sum;
    counts[t] = count;
    // Halves onto halves: the sum has one order.
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if (t < half) {
            sums[t] += sums[t + half];
            counts[t] += counts[t + half];
        }
    }
    if (t == 0u) {
        // As bits, beside counts that f32 would not hold exactly.
        stats[0] = bitcast<u32>(sums[0].x);
        stats[1] = bitcast<u32>(sums[0].y);
        stats[2] = counts[0].x;
        stats[3] = counts[0].y;
    }
}
