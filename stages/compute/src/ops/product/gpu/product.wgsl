// out = finish(A B + bias), a tile of TM rows and TN columns per workgroup, RM by RN sums per
// invocation, in registers. Slabs of TK of the depth go through workgroup memory. What A and B are,
// the functions factor_a, column and factor_b say: nothing is unfolded in memory.
@group(0) @binding(${OUT}) var<storage, read_write> out: array<f32>;

// Rows of vectors with one left free, so that neither writing nor reading meets one bank of memory
// only.
var<workgroup> tile_a: array<quad_a, ${A_TILE}>;
var<workgroup> tile_b: array<quad_b, ${B_TILE}>;

fn guarded_a(row: u32, k: u32, end: u32) -> f32 {
    if (row < p.rows && k < end) {
        return factor_a(row, k);
    }
    return 0.0;
}

fn guarded_b(k: u32, end: u32, column: u32, place: vec4i) -> f32 {
    if (column < p.columns && k < end) {
        return factor_b(k, place);
    }
    return 0.0;
}

fn put(row: u32, column: u32, part: u32, value: f32) {
    if (row < p.rows && column < p.columns) {
        // Results lie by image, row and pixel.
        let i = (column / p.pixels) * p.rows * p.pixels + row * p.pixels + column % p.pixels;
        out[part * p.rows * p.columns + i] = finish(i, value + start(i));
    }
}

#define places
#for c 4
let place${c} = column_place(column + ${c}u);
#end
#end
#define store
#for c 4
#for d 4
put(row + ${c}u, column + ${d}u, group.z, c${i}_${c}_${j}[${d}]);
#end
#end
#end

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) t: u32) {
    let ty = t / (TN / RN);
    let tx = t % (TN / RN);
    let first = group.z * p.chunk;
    let end = min(first + p.chunk, p.depth);
#for i ${QM}
#for c 4
#for j ${QN}
    var c${i}_${c}_${j} = vec4f();
#end
#end
#end
    // Where an invocation loads the same columns of every slab, their places in the image are worked out once.
#for once ${B_STAYS}
    let column = group.x * TN + (t % (TN / 4u)) * 4u;
#use places
#end
    for (var k0 = first; k0 < end; k0 += TK) {
        // The slab before is still being read.
        workgroupBarrier();
        for (var e = t; e < TK * TM / 4u; e += 256u) {
            // Neighbours take what lies side by side in memory: along the depth, or along the rows.
            let k = select(e / (TM / 4u), e % TK, A_DEPTH_FIRST == 1u);
            let quad = select(e % (TM / 4u), e / TK, A_DEPTH_FIRST == 1u);
            let row = group.y * TM + quad * 4u;
            tile_a[k * A_PITCH + quad] = quad_a(vec4f(
                guarded_a(row, k0 + k, end),
                guarded_a(row + 1u, k0 + k, end),
                guarded_a(row + 2u, k0 + k, end),
                guarded_a(row + 3u, k0 + k, end),
            ));
        }
        for (var e = t; e < TK * TN / 4u; e += 256u) {
#for once ${B_STAYS}
            let k = e / (TN / 4u);
            let quad = t % (TN / 4u);
#end
#for once ${B_MOVES}
            let k = e % TK;
            let quad = e / TK;
            let column = group.x * TN + quad * 4u;
#use places
#end
            tile_b[k * B_PITCH + quad] = quad_b(vec4f(
                guarded_b(k0 + k, end, column, place0),
                guarded_b(k0 + k, end, column + 1u, place1),
                guarded_b(k0 + k, end, column + 2u, place2),
                guarded_b(k0 + k, end, column + 3u, place3),
            ));
        }
        // The slab is whole before anyone reads it.
        workgroupBarrier();
        // Sums go along the depth in its order, whatever the tile: the choice of a tile changes no bit.
        for (var k = 0u; k < TK; k++) {
#for j ${QN}
            let b${j} = vec4f(tile_b[k * B_PITCH + tx + ${j}u * (TN / RN)]);
#end
#for i ${QM}
            let a${i} = vec4f(tile_a[k * A_PITCH + ty + ${i}u * (TM / RM)]);
#for c 4
#for j ${QN}
            c${i}_${c}_${j} = fma(vec4f(a${i}[${c}]), b${j}, c${i}_${c}_${j});
#end
#end
#end
        }
    }
#for i ${QM}
#for j ${QN}
    {
        let row = group.y * TM + (ty + ${i}u * (TM / RM)) * 4u;
        let column = group.x * TN + (tx + ${j}u * (TN / RN)) * 4u;
#use store
    }
#end
#end
}
