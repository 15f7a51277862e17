// The gradient of attention to its queries, in a second walk over the keys: scores are computed
// again.
@group(0) @binding(7) var<storage, read_write> dq: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
#use begin
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
        var d${i} = vec4f();
#end
#use scores ROWS=q COLUMNS=k S=s
#use scores ROWS=dout COLUMNS=v S=d
        workgroupBarrier();
#for i 4
        {
            let key = column0 + tx * 4u + ${i}u;
            var g = vec4f();
#for r 4
            {
                let query = row0 + ty * 4u + ${r}u;
                let seen = weight(group.y, query, key, s${i}[${r}]);
                g[${r}] = score_gradient(group.y, query, seen, d${i}[${r}]);
            }
#end
            tile[(tx * 4u + ${i}u) * 16u + ty] = g;
        }
#end
#for j ${SLICES}
#use gathered X=k SUM=sum SLICE=${j}
#end
    }
#for j ${SLICES}
#for i 4
#use put LEN=p.queries OUT=dq START=start_q SUM=sum
#end
#end
}
