// Writes the samples of each ray that are seen, one ray behind the other: distance, length and ray.
// Before the first stands how many there are.
@group(0) @binding(1) var<storage, read> rays: array<vec4f>;
@group(0) @binding(2) var<storage, read> bits: array<u32>;
@group(0) @binding(3) var<storage, read> seen: array<u32>;
@group(0) @binding(4) var<storage, read> before: array<u32>;
@group(0) @binding(5) var<storage, read_write> samples: array<vec4u>;
@group(0) @binding(6) var<storage, read_write> looked: array<u32>;

// Samples that the CPU looks at together: what a batch costs is counted as there.
const WAVE = 16u;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x == 0u) {
        samples[0] = vec4u(before[p.rays], 0u, 0u, 0u);
    }
    if (id.x >= p.rays) {
        return;
    }
    let ray = p.first + id.x;
    let count = seen[ray];
    let first = 1u + before[id.x];
    // A ray of which whole waves were visible was queried for one wave more.
    let most = (count / WAVE + 1u) * WAVE;
    var t = start_of(ray);
    var i = 0u;
    for (; i < most; i++) {
        let step = step_from(ray, t);
        if (step.length == 0.0) {
            break;
        }
        if (i < count) {
            samples[first + i] = vec4u(bitcast<u32>(step.middle), bitcast<u32>(step.length), ray, 0u);
        }
        t = step.next;
    }
    looked[ray] = i;
}
