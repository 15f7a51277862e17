// Sums over a workgroup of 256, in the order of a tree.
var<workgroup> part: array<vec2f, 256>;

fn sum_all(local: u32, value: vec2f) -> vec2f {
    // Someone may still be reading what the call before gave.
    workgroupBarrier();
    part[local] = value;
    for (var half = 128u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if (local < half) {
            part[local] += part[local + half];
        }
    }
    workgroupBarrier();
    return part[0];
}
