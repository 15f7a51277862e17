// Early ray termination: how many samples of each ray are visible. Densities are computed from front
// to back, until little of what lies behind would show. A workgroup follows 16 rays, four samples of each at a time, and nothing of
// them goes through device memory.
@group(0) @binding(1) var<storage, read> rays: array<vec4f>;
@group(0) @binding(2) var<storage, read> bits: array<u32>;
@group(0) @binding(3) var<storage, read> levels: array<Level>;
@group(0) @binding(4) var<storage, read> table: array<u32>;
@group(0) @binding(5) var<storage, read> weights: array<f32>;
@group(0) @binding(6) var<storage, read_write> seen: array<u32>;

var<workgroup> tile: array<vec4f, QUADS * ROWS>;
var<workgroup> places: array<vec4f, 64>;
var<workgroup> open_rays: array<u32, QUADS>;
var<workgroup> any_open: u32;

// -ln(1e-4): behind it less than a ten-thousandth shows.
const DEEPEST = 9.2103405;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let ray = p.first + group.x * QUADS + t;
    var is_open = t < QUADS && group.x * QUADS + t < p.rays;
    var from_t = 0.0;
    if (is_open) {
        from_t = start_of(ray);
    }
    var count = 0u;
    var depth = 0.0;
    loop {
        // Four steps of each ray before any is looked up: 64 positions keep all invocations busy in the layers. A ray that
        // ends among them wastes three at most.
        if (t < QUADS) {
#for d 4
            places[4u * t + ${d}u] = vec4f();
            if (is_open) {
                let step = step_from(ray, from_t);
                from_t = step.next;
                places[4u * t + ${d}u] = vec4f(point_at(ray, step.middle), step.length);
                is_open = step.length > 0.0;
            }
#end
            open_rays[t] = u32(places[4u * t].w > 0.0);
        }
        workgroupBarrier();
        if (t == 0u) {
            var any = 0u;
            for (var q = 0u; q < QUADS; q++) {
                any |= open_rays[q];
            }
            any_open = any;
        }
        // All leave the loop together, as barriers in it demand.
        if (workgroupUniformLoad(&any_open) == 0u) {
            break;
        }
#use encode TO=0
#use layer INPUTS=${ENCODING} OUTPUTS=64 AT=${W0} FROM=0 TO=0 FUNCTION=rectified EACH=4
        if (t < QUADS) {
            // Of the second layer only the density's column is needed.
            var raw = vec4f();
            for (var k = 0u; k < 64u; k++) {
                raw = fma(vec4f(weights[${W1}u + k * 16u]), tile[t * ROWS + k], raw);
            }
#for d 4
            {
                let length = places[4u * t + ${d}u].w;
                // In the order of the ray: whether a sample is seen depends on those before it.
                if (length > 0.0 && depth <= DEEPEST) {
                    count++;
                    depth += density_of(raw[${d}]) * length;
                }
            }
#end
            is_open = is_open && depth <= DEEPEST;
        }
        workgroupBarrier();
    }
    if (t < QUADS && group.x * QUADS + t < p.rays) {
        seen[ray] = count;
    }
}
