// For each query, the product of the output with the gradient to it.
@group(0) @binding(1) var<storage, read> out: array<f32>;
@group(0) @binding(2) var<storage, read> dout: array<f32>;
@group(0) @binding(3) var<storage, read_write> delta: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let row = (group.y * groups.x + group.x) * 256u + local;
    if (row < p.rows) {
        var sum = 0.0;
        for (var f = row * p.depth; f < (row + 1u) * p.depth; f++) {
            sum += out[f] * dout[f];
        }
        delta[row] = sum;
    }
}
