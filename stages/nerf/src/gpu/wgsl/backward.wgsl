// From the gradients to raw densities and colours to those of the networks and the hash table. The
// activations of 16 samples are worked out again, stay in the workgroup, and are replaced by their
// gradients layer by layer. The gradient to the weights is summed in registers over all samples of
// the workgroup and left for `adam_network` to join; that to the table is added up in 64-bit fixed
// point, of which a unit is 2^-52, so that the order does not matter.
@group(0) @binding(1) var<storage, read> rays: array<vec4f>;
@group(0) @binding(2) var<storage, read> samples: array<vec4u>;
// [samples]: gradients to the raw density and to three raw colours.
@group(0) @binding(3) var<storage, read> d_raw: array<vec4f>;
@group(0) @binding(4) var<storage, read> levels: array<Level>;
@group(0) @binding(5) var<storage, read> table: array<u32>;
@group(0) @binding(6) var<storage, read> weights: array<f32>;
// [workgroups, weights]
@group(0) @binding(7) var<storage, read_write> parts: array<f32>;
// [entries, 2 features, 2 words]
@group(0) @binding(8) var<storage, read_write> d_table: array<atomic<u32>>;

var<workgroup> tile: array<vec4f, QUADS * ROWS>;
var<workgroup> places: array<vec4f, 16>;
var<workgroup> total: u32;

// Adds to a number of two words, the lower first.
fn add(at: u32, value: f32) {
    // In units of the upper word, 2^-20. Beyond 2^31 the sign would be lost: so large a gradient stays as large as it can be.
    let scaled = min(abs(value) * 1048576.0, 2147483000.0);
    var high = u32(scaled);
    var low = u32((scaled - f32(high)) * 4294967296.0);
    if ((high | low) == 0u) {
        return;
    }
    // The two's complement over both words.
    if (value < 0.0) {
        low = 0u - low;
        high = ~high + select(0u, 1u, low == 0u);
    }
    // Where the lower word ran over, one is carried. Mostly nothing is, and one atomic addition does.
    let old = atomicAdd(&d_table[at], low);
    let carried = high + select(0u, 1u, old + low < low);
    if (carried != 0u) {
        atomicAdd(&d_table[at + 1u], carried);
    }
}

// One layer backward, in place: INPUTS rows from FROM on become their own gradient, from that to
// OUTPUTS rows from TO on. TURNED is where the matrix lies as [outputs, inputs], EACH how many of
// its elements an invocation sums, FUNCTION what is made of a row and its gradient.
#define layer_backward
{
    // The gradient to the weights goes first: it needs the activations, which the second half overwrites.
    let n = t % ${OUTPUTS}u;
    let k = t / ${OUTPUTS}u * ${EACH}u;
    for (var q = 0u; q < QUADS; q++) {
        let d = tile[q * ROWS + ${TO}u + n];
#for i ${EACH}
        sum_${LAYER}_${i} += dot(d, tile[q * ROWS + ${FROM}u + k + ${i}u]);
#end
    }
    // All have read the activations before any writes over them.
    workgroupBarrier();
    let column = t % ${INPUTS}u;
    let q = t / ${INPUTS}u;
    if (q < QUADS) {
        var s = vec4f();
        for (var o = 0u; o < ${OUTPUTS}u; o++) {
            s = fma(vec4f(weights[${TURNED}u + o * ${INPUTS}u + column]), tile[q * ROWS + ${TO}u + o], s);
        }
        let at = q * ROWS + ${FROM}u + column;
        tile[at] = ${FUNCTION}(tile[at], s);
    }
    workgroupBarrier();
}
#end

fn rectified_backward(x: vec4f, d: vec4f) -> vec4f {
    return select(vec4f(), d, x > vec4f());
}

fn replaced(x: vec4f, d: vec4f) -> vec4f {
    return d;
}

#define sums
#for i ${EACH}
    var sum_${LAYER}_${i} = 0.0;
    if (p.first > 0u) {
        sum_${LAYER}_${i} = parts[group.x * WEIGHTS + ${AT}u + (t / ${OUTPUTS}u * ${EACH}u + ${i}u) * ${OUTPUTS}u + t % ${OUTPUTS}u];
    }
#end
#end

#define store
#for i ${EACH}
    parts[group.x * WEIGHTS + ${AT}u + (t / ${OUTPUTS}u * ${EACH}u + ${i}u) * ${OUTPUTS}u + t % ${OUTPUTS}u] = sum_${LAYER}_${i};
#end
#end

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) t: u32,
) {
    if (t == 0u) {
        total = samples[0].x;
    }
    let end = workgroupUniformLoad(&total);
    // A workgroup without samples: its sum is joined like the others', so it must not hold what was there before.
    if (group.x * 16u >= end) {
        for (var i = t; i < WEIGHTS && p.first == 0u; i += 256u) {
            parts[group.x * WEIGHTS + i] = 0.0;
        }
        return;
    }
    // Later passes of a batch go on from what the earlier ones left.
#use sums LAYER=0 AT=${W0} OUTPUTS=64 EACH=${EACH0}
#use sums LAYER=1 AT=${W1} OUTPUTS=16 EACH=4
#use sums LAYER=2 AT=${W2} OUTPUTS=64 EACH=8
#use sums LAYER=3 AT=${W3} OUTPUTS=64 EACH=16
#use sums LAYER=4 AT=${W4} OUTPUTS=16 EACH=4
    for (var first = group.x * 16u; first < end; first += groups.x * 16u) {
        var d = vec4f();
        if (t < 16u) {
            var ray = 0u;
            // Beyond the last sample positions and gradients are zero: such columns add nothing, and no layer need ask.
            places[t] = vec4f();
            if (first + t < end) {
                let sample = samples[1u + first + t];
                ray = sample.z;
                places[t] = vec4f(point_at(ray, bitcast<f32>(sample.x)), 0.0);
                d = d_raw[first + t];
            }
            let direction = harmonics(rays[4u * ray + 3u].xyz);
#for h 16
            tile[t / 4u * ROWS + ${INPUT}u + 16u + ${h}u][t % 4u] = direction[${h}];
            tile[t / 4u * ROWS + ${OUT}u + ${h}u][t % 4u] = 0.0;
#end
#for c 3
            tile[t / 4u * ROWS + ${OUT}u + ${c}u][t % 4u] = d[${c} + 1];
#end
        }
        workgroupBarrier();
#use encode TO=0
#use layer INPUTS=${ENCODING} OUTPUTS=64 AT=${W0} FROM=0 TO=${HIDDEN} FUNCTION=rectified EACH=1
#use layer INPUTS=64 OUTPUTS=16 AT=${W1} FROM=${HIDDEN} TO=${INPUT} FUNCTION=kept EACH=1
#use layer INPUTS=32 OUTPUTS=64 AT=${W2} FROM=${INPUT} TO=${FIRST} FUNCTION=rectified EACH=1
#use layer INPUTS=64 OUTPUTS=64 AT=${W3} FROM=${FIRST} TO=${SECOND} FUNCTION=rectified EACH=1
#use layer_backward LAYER=4 INPUTS=64 OUTPUTS=16 TURNED=${T4} FROM=${SECOND} TO=${OUT} FUNCTION=rectified_backward EACH=4
#use layer_backward LAYER=3 INPUTS=64 OUTPUTS=64 TURNED=${T3} FROM=${FIRST} TO=${SECOND} FUNCTION=rectified_backward EACH=16
#use layer_backward LAYER=2 INPUTS=32 OUTPUTS=64 TURNED=${T2} FROM=${INPUT} TO=${FIRST} FUNCTION=replaced EACH=8
        // The raw density is the first of the geometry features, and has a gradient of its own.
        if (t < 16u) {
            tile[t / 4u * ROWS + ${INPUT}u][t % 4u] += d.x;
        }
        workgroupBarrier();
#use layer_backward LAYER=1 INPUTS=64 OUTPUTS=16 TURNED=${T1} FROM=${HIDDEN} TO=${INPUT} FUNCTION=rectified_backward EACH=4
#use layer_backward LAYER=0 INPUTS=${ENCODING} OUTPUTS=64 TURNED=${T0} FROM=0 TO=${HIDDEN} FUNCTION=replaced EACH=${EACH0}
        for (var e = t; e < 16u * p.levels; e += 256u) {
            let s = e % 16u;
            let l = e / 16u;
            let row = s / 4u * ROWS + 2u * l;
            let by_feature = vec2f(tile[row][s % 4u], tile[row + 1u][s % 4u]);
            // Samples that only fill the tile have nothing to add.
            if (first + s < end) {
                let level = levels[l];
                let place = place_of(level, places[s].xyz);
#for c 8
                {
                    let corner = corner_of(${c}u);
                    let by_entry = by_feature * weight_of(place, corner);
                    let at = 4u * entry_of(level, place.cell + corner);
                    add(at, by_entry.x);
                    add(at + 2u, by_entry.y);
                }
#end
            }
        }
        workgroupBarrier();
    }
#use store LAYER=0 AT=${W0} OUTPUTS=64 EACH=${EACH0}
#use store LAYER=1 AT=${W1} OUTPUTS=16 EACH=4
#use store LAYER=2 AT=${W2} OUTPUTS=64 EACH=8
#use store LAYER=3 AT=${W3} OUTPUTS=64 EACH=16
#use store LAYER=4 AT=${W4} OUTPUTS=16 EACH=4
}
