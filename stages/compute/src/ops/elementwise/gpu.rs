//! Element-by-element operators, and reductions of whole arrays.

use super::function::{Binary, Reduction, Unary};
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::each::{Each, MATH};
use crate::runtime::gpu::kernel::Kernel;
use crate::runtime::gpu::launch::{folded, one};
use crate::runtime::gpu::params::params;
use crate::runtime::gpu::pool::Buffer;

/// Elements that one workgroup reduces.
const BLOCK: usize = 4096;

params! {
    /// The constants of a function, which says what they mean.
    struct Constants {
        a: f32,
        b: f32,
    }
}

params! {
    /// Planes of so many elements.
    struct Planes {
        plane: u32,
    }
}

params! {
    /// Planes of so many elements, which belong to channels.
    struct Channels {
        plane: u32,
        channels: u32,
    }
}

params! {
    /// Rows of two halves of so many elements.
    struct Halves {
        half: u32,
    }
}

params! {
    /// How many elements there are.
    struct Length {
        len: u32,
    }
}

/// A function of every element.
pub fn unary(gpu: &Gpu, function: Unary, x: &Buffer, len: usize) -> Buffer {
    let (value, [a, b]) = match function {
        Unary::Scale(factor) => ("return p.a * x[i];", [factor, 0.0]),
        // WGSL leaves open what its `clamp` makes of NaN.
        Unary::Clamp { low, high } => (
            "let v = x[i]; return select(clamp(v, p.a, p.b), v, is_nan(v));",
            [low, high],
        ),
        Unary::Offset(number) => ("return x[i] + p.a;", [number, 0.0]),
        Unary::Leaky(slope) => ("return select(p.a * x[i], x[i], x[i] > 0.0);", [slope, 0.0]),
        Unary::Sigmoid => ("return sigmoid(x[i]);", [0.0; 2]),
        Unary::Sign => ("return f32(x[i] > 0.0) - f32(x[i] < 0.0);", [0.0; 2]),
        Unary::Silu => ("return silu(x[i]);", [0.0; 2]),
        Unary::Gelu => ("return x[i] * normal_cdf(x[i]);", [0.0; 2]),
        Unary::QuickGelu => ("return x[i] * sigmoid(1.702 * x[i]);", [0.0; 2]),
    };
    Each {
        name: "unary",
        reads: &[("x: f32", x)],
        params: Constants { a, b },
        value,
        functions: MATH,
    }
    .run(gpu, len)
}

/// A function of every pair of elements.
pub fn binary(gpu: &Gpu, function: Binary, x: &Buffer, y: &Buffer, len: usize) -> Buffer {
    let (value, [a, b]) = match function {
        Binary::Product => ("return x[i] * y[i];", [0.0; 2]),
        Binary::Sum(factors) => ("return p.a * x[i] + p.b * y[i];", factors),
        Binary::SiluSlope => ("return y[i] * silu_slope(x[i]);", [0.0; 2]),
        Binary::GeluSlope => ("return y[i] * gelu_slope(x[i]);", [0.0; 2]),
        Binary::QuickGeluSlope => ("return y[i] * quick_gelu_slope(x[i]);", [0.0; 2]),
    };
    let reads = [("x: f32", x), ("y: f32", y)];
    Each {
        name: "binary",
        reads: &reads,
        params: Constants { a, b },
        value,
        functions: MATH,
    }
    .run(gpu, len)
}

/// Every plane of `plane` elements plus its own number.
pub fn add_per_plane(gpu: &Gpu, x: &Buffer, numbers: &Buffer, plane: usize, len: usize) -> Buffer {
    let reads = [("x: f32", x), ("numbers: f32", numbers)];
    let params = Planes {
        plane: plane as u32,
    };
    let value = "return x[i] + numbers[i / p.plane];";
    Each {
        name: "add_per_plane",
        reads: &reads,
        params,
        value,
        functions: "",
    }
    .run(gpu, len)
}

/// Every plane of `plane` elements, where they are below 0 times the number of its channel.
pub fn leaky_per_channel(
    gpu: &Gpu,
    x: &Buffer,
    (slopes, channels): (&Buffer, usize),
    plane: usize,
    len: usize,
) -> Buffer {
    let reads = [("x: f32", x), ("slopes: f32", slopes)];
    let params = Channels {
        plane: plane as u32,
        channels: channels as u32,
    };
    let value = "return select(slopes[i / p.plane % p.channels] * x[i], x[i], x[i] > 0.0);";
    Each {
        name: "leaky_per_channel",
        reads: &reads,
        params,
        value,
        functions: "",
    }
    .run(gpu, len)
}

/// `a gelu(b)` for rows `[a, b]` of `2 * half` elements; `len` results.
pub fn geglu(gpu: &Gpu, x: &Buffer, half: usize, len: usize) -> Buffer {
    let params = Halves { half: half as u32 };
    let value = "let at = i / p.half * 2u * p.half + i % p.half; let b = x[at + p.half]; return x[at] * b * normal_cdf(b);";
    Each {
        name: "geglu",
        reads: &[("x: f32", x)],
        params,
        value,
        functions: MATH,
    }
    .run(gpu, len)
}

/// The gradient of [`geglu`]; `len` is twice the number of `dy`.
pub fn geglu_backward(gpu: &Gpu, x: &Buffer, dy: &Buffer, half: usize, len: usize) -> Buffer {
    let reads = [("x: f32", x), ("dy: f32", dy)];
    let params = Halves { half: half as u32 };
    let value = "let row = i / (2u * p.half); let c = i % (2u * p.half); let d = dy[row * p.half + c % p.half];
    if (c < p.half) {
        let b = x[i + p.half];
        return d * b * normal_cdf(b);
    }
    return d * x[i - p.half] * gelu_slope(x[i]);";
    Each {
        name: "geglu_backward",
        reads: &reads,
        params,
        value,
        functions: MATH,
    }
    .run(gpu, len)
}

/// A number from all elements: block by block on the device, then over the blocks in their order.
pub fn reduce(gpu: &Gpu, reduction: Reduction, x: &Buffer, len: usize) -> f64 {
    let (term, join) = match reduction {
        Reduction::Sum => ("v", "a + b"),
        Reduction::SumOfSquares => ("v * v", "a + b"),
        // As on the CPU, NaN is passed over.
        Reduction::MaxAbs => ("select(abs(v), 0.0, is_nan(v))", "max(a, b)"),
    };
    let head = format!(
        "{MATH}\nfn term(v: f32) -> f32 {{ return {term}; }}\nfn join(a: f32, b: f32) -> f32 {{ return {join}; }}\n"
    );
    let kernel = Kernel::new("reduce", &[include_str!("reduce.wgsl")], [1, 1]).having(head);
    let blocks = len.div_ceil(BLOCK);
    let parts = one(
        gpu,
        &kernel,
        &[x],
        blocks,
        Length { len: len as u32 },
        folded(blocks),
        len as u64,
    );
    let parts = gpu.read(&parts, blocks);
    // The blocks' sums are joined in f64, since there is none on the device.
    let parts = parts.into_iter().map(f64::from);
    if reduction == Reduction::MaxAbs {
        parts.fold(0.0, f64::max)
    } else {
        parts.sum()
    }
}
