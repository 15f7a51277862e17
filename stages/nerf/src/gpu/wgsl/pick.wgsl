// Marks as many members of a set of cells, drawn at random, as an eighth of them.
@group(0) @binding(1) var<storage, read> members: array<u32>;
@group(0) @binding(2) var<storage, read> before: array<u32>;
@group(0) @binding(3) var<storage, read_write> marked: array<atomic<u32>>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let count = before[p.words];
    // The number of a draw is the element of its random numbers: who draws it changes nothing.
    for (var i = id.x; i < count / 8u; i += groups.x * 256u) {
        let cell = member(below(p.step, vec2u(i, p.part), count, vec2u(p.key_low, p.key_high)));
        // A cell that is drawn twice is marked once, in whatever order.
        atomicOr(&marked[cell / 32u], 1u << (cell % 32u));
    }
}
