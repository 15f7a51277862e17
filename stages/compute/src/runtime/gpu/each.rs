//! Kernels each of whose results is a function of its own place: what most operators have in
//! common. It knows no operator but the plainest, which fills.

use super::context::Gpu;
use super::job::Command;
use super::kernel::Kernel;
use super::launch::folded;
use super::params::{Params, params};
use super::pool::Buffer;

/// Functions of single numbers, as WGSL.
pub const MATH: &str = include_str!("math.wgsl");

/// Elements per workgroup of [`Each`].
const EACH: usize = 1024;

/// An operator each of whose results is a function of its own place `i`.
pub struct Each<'a, P> {
    /// Its name, by which the pipeline is kept and labelled.
    pub name: &'static str,
    /// What it reads: names and element types as in WGSL (`x: f32`), and the arrays.
    pub reads: &'a [(&'static str, &'a Buffer)],
    /// Its parameters, which are `p` in WGSL; `p.len` is how many results there are.
    pub params: P,
    /// The body of `fn value(i: u32) -> f32`.
    pub value: &'a str,
    /// Functions that the body calls.
    pub functions: &'static str,
}

impl<P: Params> Each<'_, P> {
    /// Starts the kernel for `len` results, `f32` each.
    pub fn run(&self, gpu: &Gpu, len: usize) -> Buffer {
        let templates = &[include_str!("each.wgsl")];
        let kernel = Kernel::<P>::new(self.name, templates, [self.reads.len(), 1])
            .knowing_length()
            .having(self.head());
        let out = gpu.buffer(len);
        let reads = self.reads.iter().map(|(_, buffer)| *buffer);
        let arrays: Vec<&Buffer> = reads.chain([&out]).collect();
        // Before the other parameters, as `knowing_length` declares it.
        let length = (len as u32).to_ne_bytes();
        gpu.run_command(&Command {
            source: kernel.source(),
            arrays: &arrays,
            params: &[&length, bytemuck::bytes_of(&self.params)].concat(),
            groups: folded(len.div_ceil(EACH)),
            operations: len as u64,
        });
        out
    }

    fn head(&self) -> String {
        let array = |(at, (array, _)): (usize, &(&str, _))| {
            let (name, element) = array.split_once(": ").unwrap_or((array, "f32"));
            let binding = at + 1;
            format!("@group(0) @binding({binding}) var<storage, read> {name}: array<{element}>;\n")
        };
        let reads: String = self.reads.iter().enumerate().map(array).collect();
        let out = self.reads.len() + 1;
        format!(
            "{reads}@group(0) @binding({out}) var<storage, read_write> out: array<f32>;\n{}\n\
             fn value(i: u32) -> f32 {{\n    {}\n}}\n",
            self.functions, self.value
        )
    }
}

params! {
    /// What an array is filled with.
    struct Number {
        number: f32,
    }
}

/// `len` times the same number.
pub fn fill(gpu: &Gpu, len: usize, number: f32) -> Buffer {
    Each {
        name: "fill",
        reads: &[],
        params: Number { number },
        value: "return p.number;",
        functions: "",
    }
    .run(gpu, len)
}
