// Writes value(i) for every element i: 1024 elements per workgroup, neighbours side by side.
@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let first = (group.y * groups.x + group.x) * 1024u + local;
#for step 4
    if (first + ${step}u * 256u < p.len) {
        out[first + ${step}u * 256u] = value(first + ${step}u * 256u);
    }
#end
}
