// The gradients of attention to its keys and values, in a walk over the queries; here rows are keys
// and columns are queries.
@group(0) @binding(7) var<storage, read_write> dk: array<f32>;
@group(0) @binding(8) var<storage, read_write> dv: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
#use begin
#for j ${SLICES}
#for i 4
    var key_${j}_${i} = vec4f();
    var value_${j}_${i} = vec4f();
#end
#end
    // Earlier queries see none of these keys.
    let first = select(0u, row0, p.causal == 1u);
    for (var column0 = first; column0 < p.queries; column0 += 64u) {
#for i 4
        var s${i} = vec4f();
        var d${i} = vec4f();
#end
#use scores ROWS=k COLUMNS=q S=s
#use scores ROWS=v COLUMNS=dout S=d
        workgroupBarrier();
#for i 4
        {
            let query = column0 + tx * 4u + ${i}u;
#for r 4
            s${i}[${r}] = weight(group.y, query, row0 + ty * 4u + ${r}u, s${i}[${r}]);
#end
            tile[(tx * 4u + ${i}u) * 16u + ty] = s${i};
        }
#end
#for j ${SLICES}
#use gathered X=dout SUM=value SLICE=${j}
#end
        // The tile of weights is still being read.
        workgroupBarrier();
#for i 4
        {
            let query = column0 + tx * 4u + ${i}u;
            var g = vec4f();
#for r 4
            g[${r}] = score_gradient(group.y, query, s${i}[${r}], d${i}[${r}]);
#end
            tile[(tx * 4u + ${i}u) * 16u + ty] = g;
        }
#end
#for j ${SLICES}
#use gathered X=q SUM=key SLICE=${j}
#end
    }
#for j ${SLICES}
#for i 4
#use put LEN=p.keys OUT=dk START=start_k SUM=key
#use put LEN=p.keys OUT=dv START=start_v SUM=value
#end
#end
}
