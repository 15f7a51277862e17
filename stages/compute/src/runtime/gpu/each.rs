//! Kernels each of whose results is a function of its own place: what most operators have in common.
//! It knows no operator but the plainest, which fills.

use super::context::Gpu;
use super::kernel::Kernel;
use super::launch::{bits, folded, one};
use super::pool::Buffer;

/// Functions of single numbers, as WGSL.
pub const MATH: &str = include_str!("math.wgsl");

/// Elements per workgroup of [`Each`].
const EACH: usize = 1024;

/// An operator each of whose results is a function of its own place `i`.
pub struct Each<'a> {
    /// Its name.
    pub name: &'static str,
    /// What it reads: names and element types as in WGSL (`x: f32`), and the arrays.
    pub reads: &'a [(&'static str, &'a Buffer)],
    /// Further parameters: names and types (`plane: u32`), and their bits.
    pub words: &'a [(&'static str, u32)],
    /// The body of `fn value(i: u32) -> f32`.
    pub value: &'a str,
    /// Functions that the body calls.
    pub functions: &'static str,
}

impl Each<'_> {
    /// Computes `len` results.
    pub fn run(&self, gpu: &Gpu, len: usize) -> Buffer {
        let kernel = Kernel::new(
            self.name,
            &[include_str!("each.wgsl")],
            [self.reads.len(), 1],
        )
        .having(self.head());
        let words: Vec<u32> = std::iter::once(len as u32)
            .chain(self.words.iter().map(|(_, word)| *word))
            .collect();
        let reads: Vec<&Buffer> = self.reads.iter().map(|(_, buffer)| *buffer).collect();
        one(
            gpu,
            &kernel,
            &reads,
            len,
            &words,
            folded(len.div_ceil(EACH)),
            len as u64,
        )
    }

    fn head(&self) -> String {
        let fields: String = self
            .words
            .iter()
            .map(|(field, _)| format!("    {field},\n"))
            .collect();
        let array = |(at, (array, _)): (usize, &(&str, _))| {
            let (name, element) = array.split_once(": ").unwrap_or((array, "f32"));
            format!(
                "@group(0) @binding({}) var<storage, read> {name}: array<{element}>;\n",
                at + 1
            )
        };
        let reads: String = self.reads.iter().enumerate().map(array).collect();
        let out = self.reads.len() + 1;
        format!(
            "struct Params {{\n    len: u32,\n{fields}}}\n@group(0) @binding(0) var<uniform> p: Params;\n{reads}\
             @group(0) @binding({out}) var<storage, read_write> out: array<f32>;\n{}\n\
             fn value(i: u32) -> f32 {{\n    {}\n}}\n",
            self.functions, self.value
        )
    }
}

/// `len` times the same number.
pub fn fill(gpu: &Gpu, len: usize, value: f32) -> Buffer {
    let words = [("number: f32", bits(value))];
    Each {
        name: "fill",
        reads: &[],
        words: &words,
        value: "return p.number;",
        functions: "",
    }
    .run(gpu, len)
}
