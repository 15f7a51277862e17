//! Moving values around.

use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::each::Each;
use crate::runtime::gpu::kernel::Kernel;
use crate::runtime::gpu::launch::one;
use crate::runtime::gpu::params::params;
use crate::runtime::gpu::pool::Buffer;

params! {
    /// Rows of two arrays side by side.
    struct Pair {
        left: u32,
        right: u32,
    }
}

params! {
    /// `count` elements from `first` on of each row.
    struct Slice {
        row: u32,
        first: u32,
        count: u32,
    }
}

params! {
    /// The extents of every matrix before it is transposed.
    struct Matrices {
        rows: u32,
        columns: u32,
    }
}

params! {
    /// Planes `[h, w]`, and how much larger or smaller they become each way.
    struct Scaled {
        h: u32,
        w: u32,
        factor: u32,
    }
}

params! {
    /// Planes `[h, w]` within planes `[height, width]`.
    struct Padded {
        h: u32,
        w: u32,
        top: u32,
        left: u32,
        height: u32,
        width: u32,
    }
}

params! {
    /// A table of rows of `depth` elements.
    struct Table {
        depth: u32,
    }
}

impl Scaled {
    fn new(h: usize, w: usize, factor: usize) -> Scaled {
        let [h, w, factor] = [h, w, factor].map(|extent| extent as u32);
        Scaled { h, w, factor }
    }
}

/// Joins `outer` rows of every part; a part is an array with the length of its rows.
pub fn concat(gpu: &Gpu, parts: &[(&Buffer, usize)], outer: usize) -> Buffer {
    match parts {
        [] => gpu.buffer(0),
        [(x, row)] => slice(gpu, x, outer, *row, 0..*row),
        [first @ .., (y, right)] => {
            let left: usize = first.iter().map(|(_, row)| row).sum();
            match first {
                [(x, _)] => pair(gpu, [x, y], [left, *right], outer),
                // Two at a time: a kernel's number of arrays is fixed when it is written.
                _ => pair(gpu, [&concat(gpu, first, outer), y], [left, *right], outer),
            }
        }
    }
}

fn pair(gpu: &Gpu, [x, y]: [&Buffer; 2], [left, right]: [usize; 2], outer: usize) -> Buffer {
    let params = Pair {
        left: left as u32,
        right: right as u32,
    };
    let value = "let row = i / (p.left + p.right); let c = i % (p.left + p.right);
    if (c < p.left) {
        return x[row * p.left + c];
    }
    return y[row * p.right + c - p.left];";
    let reads = [("x: f32", x), ("y: f32", y)];
    Each {
        name: "concat",
        reads: &reads,
        params,
        value,
        functions: "",
    }
    .run(gpu, outer * (left + right))
}

/// The part `range` of each of `outer` rows of `row` elements.
pub fn slice(
    gpu: &Gpu,
    x: &Buffer,
    outer: usize,
    row: usize,
    range: std::ops::Range<usize>,
) -> Buffer {
    let params = Slice {
        row: row as u32,
        first: range.start as u32,
        count: range.len() as u32,
    };
    let value = "return x[i / p.count * p.row + p.first + i % p.count];";
    Each {
        name: "slice",
        reads: &[("x: f32", x)],
        params,
        value,
        functions: "",
    }
    .run(gpu, outer * range.len())
}

/// Each of `batch` matrices `[rows, columns]` as `[columns, rows]`.
pub fn transpose(gpu: &Gpu, x: &Buffer, batch: usize, rows: usize, columns: usize) -> Buffer {
    let kernel = Kernel::new("transpose", &[include_str!("transpose.wgsl")], [1, 1]);
    let groups = [
        columns.div_ceil(32) as u32,
        rows.div_ceil(32) as u32,
        batch as u32,
    ];
    one(
        gpu,
        &kernel,
        &[x],
        batch * rows * columns,
        Matrices {
            rows: rows as u32,
            columns: columns as u32,
        },
        groups,
        0,
    )
}

/// Every pixel repeated `factor` times both ways; `[planes, h, w]` is the extent of `x`.
pub fn upsample(gpu: &Gpu, x: &Buffer, [planes, h, w]: [usize; 3], factor: usize) -> Buffer {
    let value =
        "let wide = p.w * p.factor; return x[i / (wide * p.factor) * p.w + i % wide / p.factor];";
    let len = planes * h * w * factor * factor;
    Each {
        name: "upsample",
        reads: &[("x: f32", x)],
        params: Scaled::new(h, w, factor),
        value,
        functions: "",
    }
    .run(gpu, len)
}

/// The sum over every block of `factor` by `factor`; `[planes, h, w]` is the extent of the result.
pub fn upsample_backward(
    gpu: &Gpu,
    dy: &Buffer,
    [planes, h, w]: [usize; 3],
    factor: usize,
) -> Buffer {
    let value = "let wide = p.w * p.factor; var sum = 0.0;
    for (var y = 0u; y < p.factor; y++) {
        for (var x = 0u; x < p.factor; x++) {
            sum += dy[(i / p.w * p.factor + y) * wide + i % p.w * p.factor + x];
        }
    }
    return sum;";
    let reads = [("dy: f32", dy)];
    Each {
        name: "upsample_backward",
        reads: &reads,
        params: Scaled::new(h, w, factor),
        value,
        functions: "",
    }
    .run(gpu, planes * h * w)
}

/// Every `factor * factor` planes laid out as one of blocks; `[planes, h, w]` are the planes of the
/// result, and the extents of one before.
pub fn shuffle(gpu: &Gpu, x: &Buffer, [planes, h, w]: [usize; 3], factor: usize) -> Buffer {
    let value =
        "let column = i % (p.w * p.factor); let y = i / (p.w * p.factor) % (p.h * p.factor);
    let plane = i / (p.w * p.factor) / (p.h * p.factor);
    let source = (plane * p.factor + y % p.factor) * p.factor + column % p.factor;
    return x[(source * p.h + y / p.factor) * p.w + column / p.factor];";
    let len = planes * h * w * factor * factor;
    Each {
        name: "shuffle",
        reads: &[("x: f32", x)],
        params: Scaled::new(h, w, factor),
        value,
        functions: "",
    }
    .run(gpu, len)
}

/// The inverse of [`shuffle`]; `[planes, h, w]` are the planes of `x`, and the extents of one
/// afterwards.
pub fn unshuffle(gpu: &Gpu, x: &Buffer, [planes, h, w]: [usize; 3], factor: usize) -> Buffer {
    let value = "let plane = i / (p.w * p.h); let y = i / p.w % p.h; let f = p.factor;
    let row = (plane / (f * f) * p.h + y) * f + plane / f % f;
    return x[(row * p.w + i % p.w) * f + plane % f];";
    let len = planes * h * w * factor * factor;
    Each {
        name: "unshuffle",
        reads: &[("x: f32", x)],
        params: Scaled::new(h, w, factor),
        value,
        functions: "",
    }
    .run(gpu, len)
}

/// `[planes, h, w]` continued by mirroring, `[top, bottom, left, right]` pixels wide.
pub fn pad_reflect(gpu: &Gpu, x: &Buffer, [planes, h, w]: [usize; 3], pad: [usize; 4]) -> Buffer {
    let [top, bottom, left, right] = pad;
    let height = top + h + bottom;
    let width = left + w + right;
    let params = Padded {
        h: h as u32,
        w: w as u32,
        top: top as u32,
        left: left as u32,
        height: height as u32,
        width: width as u32,
    };
    // Unsigned numbers have no negative difference, so the larger is told first.
    let functions = "fn mirrored(i: u32, before: u32, len: u32) -> u32 {
    let distance = max(i, before) - min(i, before);
    return select(2u * (len - 1u) - distance, distance, i < before || distance < len);
}";
    let value = "let y = mirrored(i / p.width % p.height, p.top, p.h); let column = mirrored(i % p.width, p.left, p.w);
    return x[(i / (p.width * p.height) * p.h + y) * p.w + column];";
    Each {
        name: "pad_reflect",
        reads: &[("x: f32", x)],
        params,
        value,
        functions,
    }
    .run(gpu, planes * height * width)
}

/// Row `id` of the table for every id.
pub fn gather_rows(gpu: &Gpu, table: &Buffer, depth: usize, ids: &[u32]) -> Buffer {
    let ids_on_device = gpu.upload(bytemuck::cast_slice(ids));
    let reads = [("x: f32", table), ("ids: u32", &ids_on_device)];
    let params = Table {
        depth: depth as u32,
    };
    let value = "return x[ids[i / p.depth] * p.depth + i % p.depth];";
    Each {
        name: "gather_rows",
        reads: &reads,
        params,
        value,
        functions: "",
    }
    .run(gpu, ids.len() * depth)
}
