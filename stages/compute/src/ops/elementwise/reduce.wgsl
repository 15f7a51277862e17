// One number per workgroup of 4096 elements, joined in the order of a tree: what is left, the host
// joins.
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

var<workgroup> part: array<f32, 256>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = group.y * groups.x + group.x;
    var value = 0.0;
    // Neighbours read neighbouring numbers, 256 apart from one round to the next.
#for step 16
    if (block * 4096u + ${step}u * 256u + local < p.len) {
        value = join(value, term(x[block * 4096u + ${step}u * 256u + local]));
    }
#end
    part[local] = value;
    for (var half = 128u; half > 0u; half /= 2u) {
        // What a round reads, others wrote in the one before.
        workgroupBarrier();
        if (local < half) {
            part[local] = join(part[local], part[local + half]);
        }
    }
    if (local == 0u && block * 4096u < p.len) {
        out[block] = part[0];
    }
}
