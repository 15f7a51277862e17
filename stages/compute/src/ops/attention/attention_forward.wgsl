// The output of attention and each row's log-sum-exp, in one walk over the keys that never holds
// all scores.
@group(0) @binding(4) var<storage, read_write> out: array<f32>;
@group(0) @binding(5) var<storage, read_write> lse: array<f32>;

#define renew
// Rows' largest score so far, and what the sums before it are worth now: weights are relative to the
// largest, so that no exponential overflows.
workgroupBarrier();
slab_rows[tx * 16u + ty] = max(max(s0, s1), max(s2, s3));
workgroupBarrier();
var top = most;
for (var i = 0u; i < 16u; i++) {
    top = max(top, slab_rows[i * 16u + ty]);
}
let fade = exp(most - top);
most = top;
#end

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let ty = t / 16u;
    let tx = t % 16u;
    let row0 = group.x * 64u;
    let feature0 = group.z * ${SLICES}u * 64u;
    let start_q = start_of(group.y, p.queries);
    let start_k = start_of(group.y, p.keys);
    let start_v = start_k;
    var most = vec4f(FAR);
    var total = vec4f();
#for j ${SLICES}
#for i 4
    var sum_${j}_${i} = vec4f();
#end
#end
    // No row of the tile sees a key beyond its own last one.
    let end = select(p.keys, min(p.keys, row0 + 64u), p.causal == 1u);
    for (var column0 = 0u; column0 < end; column0 += 64u) {
#for i 4
        var s${i} = vec4f();
#end
#use scores ROWS=q COLUMNS=k S=s
#for i 4
        s${i} *= p.scale;
#for r 4
        if (!sees(row0 + ty * 4u + ${r}u, column0 + tx * 4u + ${i}u)) {
            s${i}[${r}] = FAR;
        }
#end
#end
#use renew
#for i 4
        // Of a row that sees no key yet `most` is FAR itself, and the exponential would be 1.
        s${i} = select(exp(s${i} - most), vec4f(), s${i} == vec4f(FAR));
        tile[(tx * 4u + ${i}u) * 16u + ty] = s${i};
#end
        slab_columns[tx * 16u + ty] = (s0 + s1) + (s2 + s3);
        workgroupBarrier();
        total *= fade;
        for (var i = 0u; i < 16u; i++) {
            total += slab_columns[i * 16u + ty];
        }
#for j ${SLICES}
#for i 4
        sum_${j}_${i} *= fade[${i}];
#end
#use gathered X=v SUM=sum SLICE=${j}
#end
    }
    for (var i = 0u; i < 4u; i++) {
        let row = row0 + ty * 4u + i;
        // All slices and all invocations of a row have the same sums: one of them writes.
        if (row < p.queries && tx == 0u && group.z == 0u) {
            let token = group.y / p.heads * p.queries + row;
            lse[token * p.heads + group.y % p.heads] = most[i] + log(total[i]);
        }
    }
#for j ${SLICES}
#for i 4
    for (var c = 0u; c < 4u; c++) {
        let row = row0 + ty * 4u + ${i}u;
        let f = feature0 + ${j}u * 64u + tx * 4u + c;
        if (row < p.queries && f < p.depth) {
            out[start_q + row * p.heads * p.depth + f] = sum_${j}_${i}[c] / total[${i}];
        }
    }
#end
#end
}
