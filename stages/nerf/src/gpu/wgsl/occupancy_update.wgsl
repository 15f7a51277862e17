// Measures the density at a random point in each cell of a set, 64 at a time, and folds the optical
// depth of the shortest step there into the grid.
@group(0) @binding(1) var<storage, read> members: array<u32>;
@group(0) @binding(2) var<storage, read> before: array<u32>;
@group(0) @binding(3) var<storage, read> levels: array<Level>;
@group(0) @binding(4) var<storage, read> table: array<u32>;
@group(0) @binding(5) var<storage, read> weights: array<f32>;
@group(0) @binding(6) var<storage, read_write> values: array<f32>;

var<workgroup> tile: array<vec4f, QUADS * ROWS>;
var<workgroup> places: array<vec4f, 64>;
var<workgroup> total: u32;

fn point_in(cell: u32) -> vec3f {
    let corner = vec3f(vec3u(cell % p.size_x, cell / p.size_x % p.size_y, cell / (p.size_x * p.size_y)));
    let fraction = uniform_numbers(p.step, vec2u(cell, 0u), vec2u(p.key_low, p.key_high));
    return (corner + fraction.xyz) / p.resolution;
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) t: u32,
) {
    if (t == 0u) {
        total = before[p.words];
    }
    let end = workgroupUniformLoad(&total);
    for (var first = group.x * 64u; first < end; first += groups.x * 64u) {
        var cell = 0u;
        if (t < 64u) {
            // Behind the end the last member again, whose place is a sound one; nothing is written
            // for it.
            cell = member(min(first + t, end - 1u));
            places[t] = vec4f(point_in(cell), 0.0);
        }
        workgroupBarrier();
#use encode TO=0
#use layer INPUTS=${ENCODING} OUTPUTS=64 AT=${W0} FROM=0 TO=0 FUNCTION=rectified EACH=4
#use layer INPUTS=64 OUTPUTS=16 AT=${W1} FROM=0 TO=0 FUNCTION=kept EACH=1
        if (t < 64u && first + t < end) {
            let fresh = density_of(tile[t / 4u * ROWS][t % 4u]) * p.shortest;
            // Cells that no camera sees stay empty. Each member is one invocation's, so no two
            // write to one.
            if (values[cell] >= 0.0) {
                values[cell] = max(p.decay * values[cell], fresh);
            }
        }
        workgroupBarrier();
    }
}
