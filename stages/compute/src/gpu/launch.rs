//! How operators start kernels: what most of them have in common. It knows no operator.

use super::context::{Gpu, Job};
use super::kernel::Kernel;
use super::pool::Buffer;

/// Elements per workgroup of [`Each`].
const EACH: usize = 1024;

/// Workgroups for `count` pieces of work, folded into two axes where one has not room enough.
pub fn folded(count: usize) -> [u32; 3] {
    let rows = count.div_ceil(1 << 15);
    [
        if rows > 1 { 1 << 15 } else { count as u32 },
        rows as u32,
        1,
    ]
}

/// The bits of a float as a parameter.
pub fn bits(value: f32) -> u32 {
    value.to_bits()
}

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
            &[include_str!("wgsl/each.wgsl")],
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

/// Runs a kernel that writes one new array of `len` numbers.
pub fn one(
    gpu: &Gpu,
    kernel: &Kernel,
    reads: &[&Buffer],
    len: usize,
    words: &[u32],
    groups: [u32; 3],
    operations: u64,
) -> Buffer {
    let out = gpu.buffer(len);
    let arrays: Vec<&Buffer> = reads.iter().copied().chain([&out]).collect();
    let groups = if len == 0 { [0; 3] } else { groups };
    gpu.run(&Job {
        kernel,
        arrays: &arrays,
        words,
        groups,
        operations,
    });
    out
}
