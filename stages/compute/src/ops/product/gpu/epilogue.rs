//! What follows the sums of a product, wherever they end: in the product's own kernel, or where the
//! parts of a cut depth are joined. The numbers are the same as on the CPU.

use crate::ops::product::finish::Finish;
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::each::Each;
use crate::runtime::gpu::params::params;
use crate::runtime::gpu::pool::Buffer;

/// What is added to the sums, and what becomes of them then.
pub struct Epilogue<'a> {
    /// A number for each row or column.
    pub bias: Option<Bias<'a>>,
    /// What becomes of the results, bias and all.
    pub finish: Finish<&'a Buffer>,
}

/// To result `i`, number `i / inner % count` is added.
#[derive(Clone, Copy)]
pub struct Bias<'a> {
    pub numbers: &'a Buffer,
    pub inner: usize,
    pub count: usize,
}

params! {
    /// The parts of a cut depth, and what follows their sum.
    struct Parts {
        parts: u32,
        bias_inner: u32,
        bias_count: u32,
        slope: f32,
    }
}

const BIASED: &str = "fn start(i: u32) -> f32 {
    return bias[i / p.bias_inner % p.bias_count];
}
";
const UNBIASED: &str = "fn start(i: u32) -> f32 {
    return 0.0;
}
";

impl<'a> Epilogue<'a> {
    /// The sums as they are.
    pub const NOTHING: Epilogue<'static> = Epilogue {
        bias: None,
        finish: Finish::None,
    };

    /// What it reads: the bias, then what the finish adds.
    pub fn reads(&self) -> Vec<&'a Buffer> {
        let bias = self.bias.map(|bias| bias.numbers);
        bias.into_iter().chain(self.added()).collect()
    }

    fn added(&self) -> Option<&'a Buffer> {
        match self.finish {
            Finish::Add(other) => Some(other),
            _ => None,
        }
    }

    /// How outputs find their bias.
    pub fn bias_at(&self) -> [u32; 2] {
        let places = |bias: Bias| [bias.inner, bias.count].map(|extent| extent as u32);
        self.bias.map_or([1, 1], places)
    }

    /// The finish's slope; without one, any.
    pub fn slope(&self) -> f32 {
        match self.finish {
            Finish::Leaky(slope) => slope,
            _ => 0.0,
        }
    }

    /// The functions `start`, which gives what is added to sum `i`, and `finish`; and the arrays
    /// that they read, declared from binding `first` on.
    pub fn functions(&self, first: usize) -> String {
        let declared = |(at, name)| {
            let binding = first + at;
            format!("@group(0) @binding({binding}) var<storage, read> {name}: array<f32>;\n")
        };
        let bias = self.bias.map(|_| "bias");
        let added = self.added().map(|_| "added");
        let arrays = bias.into_iter().chain(added).enumerate().map(declared);
        let start = if bias.is_some() { BIASED } else { UNBIASED };
        let value = self.finished("x");
        format!(
            "{}{start}fn finish(i: u32, x: f32) -> f32 {{\n    return {value};\n}}\n",
            arrays.collect::<String>()
        )
    }

    /// The number `x`, finished, as WGSL.
    fn finished(&self, x: &str) -> String {
        match self.finish {
            Finish::None => x.to_owned(),
            Finish::Leaky(_) => format!("select(p.slope * {x}, {x}, {x} > 0.0)"),
            Finish::Add(_) => format!("{x} + added[i]"),
        }
    }

    /// Sums the parts of the depth, adds the bias and finishes. A kernel of its own keeps the parts in
    /// their order, which atomic additions would not.
    pub fn join(&self, gpu: &Gpu, parts: &Buffer, count: usize, len: usize) -> Buffer {
        let [bias_inner, bias_count] = self.bias_at();
        let params = Parts {
            parts: count as u32,
            bias_inner,
            bias_count,
            slope: self.slope(),
        };
        let mut reads = vec![("x: f32", parts)];
        let mut value = String::from(
            "var sum = 0.0;
    for (var part = 0u; part < p.parts; part++) {
        sum += x[part * p.len + i];
    }
",
        );
        if let Some(bias) = self.bias {
            reads.push(("bias: f32", bias.numbers));
            value += "    sum += bias[i / p.bias_inner % p.bias_count];\n";
        }
        reads.extend(self.added().map(|added| ("added: f32", added)));
        value += &format!("    return {};", self.finished("sum"));
        Each {
            name: "join",
            reads: &reads,
            params,
            value: &value,
            functions: "",
        }
        .run(gpu, len)
    }
}
