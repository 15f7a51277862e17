//! Kernels as text. It knows how kernels see their arrays: parameters at binding 0, then what they
//! read, then what they write, in that order.

use std::marker::PhantomData;

use super::params::Params;
use super::split::split;
use super::template::expand;

/// A kernel whose parameters are a `P`.
#[derive(Clone, Debug)]
pub struct Kernel<P> {
    source: KernelSource,
    parameters: PhantomData<fn(P)>,
}

/// What decides the text of a kernel, and so tells it from others.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct KernelSource {
    /// Its name, for messages.
    pub name: &'static str,
    /// Extents that are known when it is compiled.
    pub constants: Vec<(&'static str, u32)>,
    /// WGSL in front of the templates: the functions that they leave open.
    pub head: String,
    /// How many arrays it reads and writes.
    pub arrays: [usize; 2],
    /// Whether it names numbers of 16 bits, which not every adapter's kernels can.
    pub halves: bool,
    /// The fields of its parameters.
    pub fields: Vec<&'static str>,
    /// The templates that it is made of, one after the other.
    pub templates: &'static [&'static str],
}

impl<P: Params> Kernel<P> {
    /// A kernel without constants or functions of its own, which reads and writes so many arrays.
    pub fn new(
        name: &'static str,
        templates: &'static [&'static str],
        arrays: [usize; 2],
    ) -> Kernel<P> {
        Kernel {
            source: KernelSource {
                name,
                constants: Vec::new(),
                head: String::new(),
                arrays,
                halves: false,
                fields: vec![P::FIELDS],
                templates,
            },
            parameters: PhantomData,
        }
    }

    /// Sets extents that are known when the kernel is compiled.
    pub fn with(mut self, constants: &[(&'static str, u32)]) -> Kernel<P> {
        self.source.constants = constants.to_vec();
        self
    }

    /// Adds functions that the templates leave open.
    pub fn having(mut self, head: String) -> Kernel<P> {
        self.source.head = head;
        self
    }

    /// Says whether the kernel names numbers of 16 bits.
    pub fn naming_halves(mut self, halves: bool) -> Kernel<P> {
        self.source.halves = halves;
        self
    }

    /// Puts the number of results before all other parameters.
    pub(super) fn knowing_length(mut self) -> Kernel<P> {
        self.source.fields.insert(0, "    len: u32,\n");
        self
    }

    /// What decides its text.
    pub fn source(&self) -> &KernelSource {
        &self.source
    }
}

impl KernelSource {
    /// Its text for arrays that lie in so many pieces each; `None` if one cannot lie in pieces.
    pub fn text(&self, pieces: &Pieces) -> Option<String> {
        let constants: String = self
            .constants
            .iter()
            .map(|(name, value)| format!("const {name} = {value}u;\n"))
            .collect();
        let text = format!(
            "struct Params {{\n{}}}\n@group(0) @binding(0) var<uniform> p: Params;\n{constants}{}\n{}",
            self.fields.concat(),
            self.head,
            expand(&self.templates.join("\n"), &self.constants)
        );
        let text = if pieces.are_whole() {
            text
        } else {
            split(&text, &pieces.counts, pieces.window)?
        };
        Some(if self.halves {
            // WGSL wants it before all declarations.
            format!("enable f16;\n{text}")
        } else {
            text
        })
    }

    /// How many pieces it reads and writes.
    pub fn bindings(&self, pieces: &Pieces) -> [usize; 2] {
        let (read, written) = pieces.counts.split_at(self.arrays[0]);
        [read, written].map(|counts| counts.iter().sum::<u32>() as usize)
    }
}

/// In how many pieces the arrays of a kernel lie, each no longer than a kernel may see.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pieces {
    /// Of each array, in the order of its bindings.
    pub counts: Vec<u32>,
    /// Bytes of a piece; only the last may be shorter.
    pub window: u64,
}

impl Pieces {
    /// Whether every array is one piece.
    pub fn are_whole(&self) -> bool {
        self.counts.iter().all(|&count| count == 1)
    }
}
