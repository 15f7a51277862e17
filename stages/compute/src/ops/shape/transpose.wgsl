// Each of `batch` matrices [rows, columns] as [columns, rows], by tiles of 32x32 that are read and
// written along their rows.
@group(0) @binding(1) var<storage, read> x: array<f32>;
@group(0) @binding(2) var<storage, read_write> out: array<f32>;

// Rows of 33, so that a column is not in one bank of memory only.
var<workgroup> tile: array<f32, 1056>;

@compute @workgroup_size(32, 8)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let start = group.z * p.rows * p.columns;
    for (var y = local.y; y < 32u; y += 8u) {
        let row = group.y * 32u + y;
        let column = group.x * 32u + local.x;
        if (row < p.rows && column < p.columns) {
            tile[y * 33u + local.x] = x[start + row * p.columns + column];
        }
    }
    workgroupBarrier();
    for (var y = local.y; y < 32u; y += 8u) {
        let row = group.y * 32u + local.x;
        let column = group.x * 32u + y;
        if (row < p.rows && column < p.columns) {
            out[start + column * p.rows + row] = tile[local.x * 33u + y];
        }
    }
}
