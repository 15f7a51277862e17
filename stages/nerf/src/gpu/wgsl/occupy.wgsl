// The bits of the cells that are occupied, a word per invocation.
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read> threshold: array<f32>;
@group(0) @binding(3) var<storage, read_write> bits: array<u32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) t: u32,
) {
    let word = (group.y * groups.x + group.x) * 256u + t;
    if (32u * word >= p.cells) {
        return;
    }
    var found = 0u;
    // The last word may have fewer cells: what is behind them stays empty.
    for (var i = 0u; i < min(32u, p.cells - 32u * word); i++) {
        found |= u32(values[32u * word + i] >= threshold[0]) << i;
    }
    bits[word] = found;
}
