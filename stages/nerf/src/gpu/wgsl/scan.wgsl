// Sums of all counts before each, and at the end the sum of all. One workgroup, each invocation a
// stretch of its own.
@group(0) @binding(1) var<storage, read> x: array<u32>;
@group(0) @binding(2) var<storage, read_write> before: array<u32>;

var<workgroup> sums: array<u32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) t: u32) {
    // Workgroups cannot wait for each other within a kernel, so that one does it all.
    let stretch = (p.len + 255u) / 256u;
    let first = min(t * stretch, p.len);
    let end = min(first + stretch, p.len);
    var sum = 0u;
    for (var i = first; i < end; i++) {
        sum += count_of(x[p.first + i]);
    }
    sums[t] = sum;
    workgroupBarrier();
    // Doubling distances: after eight rounds each has the sum of all up to its own.
    for (var distance = 1u; distance < 256u; distance *= 2u) {
        var other = 0u;
        if (t >= distance) {
            other = sums[t - distance];
        }
        // All have read before any writes.
        workgroupBarrier();
        sums[t] += other;
        workgroupBarrier();
    }
    var running = sums[t] - sum;
    for (var i = first; i < end; i++) {
        before[i] = running;
        running += count_of(x[p.first + i]);
    }
    if (t == 255u) {
        before[p.len] = running;
    }
}
