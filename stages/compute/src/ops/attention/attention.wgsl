// Multi-head attention by tiles of 64 rows and 64 columns, 4x4 scores per invocation in registers
// (Dao 2023). One workgroup takes one head and one tile of rows; along z, a slice of the head's
// features, so that no head is too deep for the registers.
@group(0) @binding(1) var<storage, read> q: array<f32>;
@group(0) @binding(2) var<storage, read> k: array<f32>;
@group(0) @binding(3) var<storage, read> v: array<f32>;

// Stands for minus infinity, which a driver may take it that no number is.
const FAR = -1e30;

// A slab of 16 features of 64 rows: feature by feature, four rows to a vector, and one left free,
// so that neither writing nor reading meets one bank of memory only. Also 16 rows of 64 features,
// four features to a vector.
var<workgroup> slab_rows: array<vec4f, 272>;
var<workgroup> slab_columns: array<vec4f, 272>;
// A tile of 64 columns by 64 rows, four rows to a vector.
var<workgroup> tile: array<vec4f, 1024>;

// Four rows of one feature of array X.
#define gather
vec4f(
#for i 4
at_${X}(start_${X}, ${ROW} + ${i}u, ${F}),
#end
);
#end

// Four columns of rows ROWS times columns COLUMNS, a vector of four rows each.
#define scores
for (var f0 = 0u; f0 < p.depth; f0 += 16u) {
    workgroupBarrier();
    slab_rows[t % 16u * 17u + t / 16u] =
#use gather X=${ROWS} ROW=row0+t/16u*4u F=f0+t%16u
    slab_columns[t % 16u * 17u + t / 16u] =
#use gather X=${COLUMNS} ROW=column0+t/16u*4u F=f0+t%16u
    workgroupBarrier();
    for (var f = 0u; f < 16u; f++) {
        let a = slab_rows[f * 17u + ty];
        let b = slab_columns[f * 17u + tx];
#for i 4
        ${S}${i} = fma(a, vec4f(b[${i}]), ${S}${i});
#end
    }
}
#end

// Adds the tile, turned, times 64 features of array X to SUM: the rows of X are the columns of the
// tile.
#define gathered
for (var j = 0u; j < 64u; j += 16u) {
    workgroupBarrier();
    let feature = feature0 + ${SLICE}u * 64u + t % 16u * 4u;
    slab_rows[t] = quad_${X}(start_${X}, column0 + j + t / 16u, feature);
    workgroupBarrier();
    for (var c = 0u; c < 16u; c++) {
        let a = tile[(j + c) * 16u + ty];
        let b = slab_rows[c * 16u + tx];
#for i 4
        ${SUM}_${SLICE}_${i} = fma(vec4f(a[${i}]), b, ${SUM}_${SLICE}_${i});
#end
    }
}
#end

// The functions that read array X of LEN tokens; nothing lies beyond its rows and the features of a
// head.
#define reader
fn at_${X}(start: u32, row: u32, f: u32) -> f32 {
    if (row < ${LEN} && f < p.depth) {
        return ${X}[start + row * p.heads * p.depth + f];
    }
    return 0.0;
}

fn quad_${X}(start: u32, row: u32, f: u32) -> vec4f {
    return vec4f(
        at_${X}(start, row, f),
        at_${X}(start, row, f + 1u),
        at_${X}(start, row, f + 2u),
        at_${X}(start, row, f + 3u),
    );
}
#end

#use reader X=q LEN=p.queries
#use reader X=k LEN=p.keys
#use reader X=v LEN=p.keys

// Where the head of a workgroup begins in an array of `tokens` tokens.
fn start_of(which: u32, tokens: u32) -> u32 {
    return (which / p.heads * tokens * p.heads + which % p.heads) * p.depth;
}

fn sees(query: u32, key: u32) -> bool {
    return key < p.keys && query < p.queries && (p.causal == 0u || key <= query);
}
