// Raw densities and colours of all samples: look-ups and both networks, 64 samples at a time. The
// workgroups take turns.
@group(0) @binding(1) var<storage, read> rays: array<vec4f>;
@group(0) @binding(2) var<storage, read> samples: array<vec4u>;
@group(0) @binding(3) var<storage, read> levels: array<Level>;
@group(0) @binding(4) var<storage, read> table: array<u32>;
@group(0) @binding(5) var<storage, read> weights: array<f32>;
// [samples]: raw density and three raw colours.
@group(0) @binding(6) var<storage, read_write> raw: array<vec4f>;

var<workgroup> tile: array<vec4f, QUADS * ROWS>;
var<workgroup> places: array<vec4f, 64>;
var<workgroup> total: u32;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) t: u32,
) {
    // One invocation reads it for all: barriers in the loop need a bound that the compiler knows to be the same for all.
    if (t == 0u) {
        total = samples[0].x;
    }
    let end = workgroupUniformLoad(&total);
    for (var first = group.x * 64u; first < end; first += groups.x * 64u) {
        let i = first + t;
        let is_sample = t < 64u && i < end;
        var ray = 0u;
        if (is_sample) {
            let sample = samples[1u + i];
            ray = sample.z;
            places[t] = vec4f(point_at(ray, bitcast<f32>(sample.x)), 0.0);
        } else if (t < 64u) {
            places[t] = vec4f();
        }
        workgroupBarrier();
#use encode TO=0
#use layer INPUTS=${ENCODING} OUTPUTS=64 AT=${W0} FROM=0 TO=0 FUNCTION=rectified EACH=4
#use layer INPUTS=64 OUTPUTS=16 AT=${W1} FROM=0 TO=0 FUNCTION=kept EACH=1
        // The raw density is the first of the 16 features that the colour network sees; it is kept before that network
        // overwrites the tile.
        var density = 0.0;
        if (t < 64u) {
            density = tile[t / 4u * ROWS][t % 4u];
            // Columns without a sample take ray 0's; nothing of them is written.
            let direction = harmonics(rays[4u * ray + 3u].xyz);
#for h 16
            tile[t / 4u * ROWS + 16u + ${h}u][t % 4u] = direction[${h}];
#end
        }
        workgroupBarrier();
#use layer INPUTS=32 OUTPUTS=64 AT=${W2} FROM=0 TO=0 FUNCTION=rectified EACH=4
#use layer INPUTS=64 OUTPUTS=64 AT=${W3} FROM=0 TO=0 FUNCTION=rectified EACH=4
#use layer INPUTS=64 OUTPUTS=16 AT=${W4} FROM=0 TO=0 FUNCTION=kept EACH=1
        if (is_sample) {
            let q = t / 4u * ROWS;
            raw[i] = vec4f(density, tile[q][t % 4u], tile[q + 1u][t % 4u], tile[q + 2u][t % 4u]);
        }
        workgroupBarrier();
    }
}
