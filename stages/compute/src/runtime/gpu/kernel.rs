//! Kernels as text, and as pipelines, each compiled once. It knows how kernels see their arrays:
//! parameters at binding 0, then what they read, then what they write, in that order.

use std::collections::BTreeMap;

use super::split::split;
use super::template::expand;

/// What decides the text of a kernel.
#[derive(Clone, Debug)]
pub struct Kernel {
    /// Its name: stands for `templates`.
    pub name: &'static str,
    /// The templates that it is made of, one after the other.
    pub templates: &'static [&'static str],
    /// Extents that are known when it is compiled.
    pub constants: Vec<(&'static str, u32)>,
    /// WGSL in front of the templates: the functions that they leave open.
    pub head: String,
    /// How many arrays it reads and writes.
    pub arrays: [usize; 2],
    /// Whether it names numbers of 16 bits, which not every adapter's kernels can.
    pub halves: bool,
}

impl Kernel {
    /// A kernel without constants or functions of its own.
    pub fn new(
        name: &'static str,
        templates: &'static [&'static str],
        arrays: [usize; 2],
    ) -> Kernel {
        Kernel {
            name,
            templates,
            constants: Vec::new(),
            head: String::new(),
            arrays,
            halves: false,
        }
    }

    /// The same with extents that are known when it is compiled.
    pub fn with(self, constants: &[(&'static str, u32)]) -> Kernel {
        Kernel {
            constants: constants.to_vec(),
            ..self
        }
    }

    /// The same with functions that the templates leave open.
    pub fn having(self, head: String) -> Kernel {
        Kernel { head, ..self }
    }

    /// Its text for arrays that lie in so many pieces each; `None` if one cannot lie in pieces.
    fn text(&self, pieces: &Pieces) -> Option<String> {
        let constants: String = self
            .constants
            .iter()
            .map(|(name, value)| format!("const {name} = {value}u;\n"))
            .collect();
        let text = format!(
            "{constants}{}\n{}",
            self.head,
            expand(&self.templates.join("\n"), &self.constants)
        );
        let text = if pieces.are_whole() {
            text
        } else {
            split(&text, &pieces.counts, pieces.window)?
        };
        Some(if self.halves {
            format!("enable f16;\n{text}")
        } else {
            text
        })
    }

    /// How many pieces it reads and writes.
    fn bindings(&self, pieces: &Pieces) -> [usize; 2] {
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

/// What tells kernels apart.
type Identity = (&'static str, Vec<(&'static str, u32)>, String, Vec<u32>);

/// The layouts that kernels of equally many arrays share.
struct Layout {
    group: wgpu::BindGroupLayout,
    pipeline: wgpu::PipelineLayout,
}

/// A kernel that can be started.
#[derive(Clone)]
pub struct Pipeline {
    /// The code.
    pub code: wgpu::ComputePipeline,
    /// How its arrays are bound.
    pub group: wgpu::BindGroupLayout,
}

/// All kernels of one device.
#[derive(Default)]
pub struct Kernels {
    layouts: BTreeMap<[usize; 2], Layout>,
    pipelines: BTreeMap<Identity, Pipeline>,
}

impl Kernels {
    /// The pipeline of `kernel`, compiled at the first call; `None` if its arrays cannot lie in
    /// such pieces.
    pub fn get(
        &mut self,
        device: &wgpu::Device,
        kernel: &Kernel,
        pieces: &Pieces,
    ) -> Option<Pipeline> {
        let identity = (
            kernel.name,
            kernel.constants.clone(),
            kernel.head.clone(),
            pieces.counts.clone(),
        );
        if let Some(pipeline) = self.pipelines.get(&identity) {
            return Some(pipeline.clone());
        }
        let text = kernel.text(pieces)?;
        let bindings = kernel.bindings(pieces);
        let layout = self
            .layouts
            .entry(bindings)
            .or_insert_with(|| layout(device, bindings));
        let code = compile(device, kernel.name, text, &layout.pipeline);
        let pipeline = Pipeline {
            code,
            group: layout.group.clone(),
        };
        self.pipelines.insert(identity, pipeline.clone());
        Some(pipeline)
    }

    /// How many were compiled.
    pub fn count(&self) -> u64 {
        self.pipelines.len() as u64
    }
}

fn compile(
    device: &wgpu::Device,
    name: &'static str,
    text: String,
    layout: &wgpu::PipelineLayout,
) -> wgpu::ComputePipeline {
    let source = wgpu::ShaderSource::Wgsl(text.into());
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(name),
        source,
    });
    // Every kernel writes the memory that its workgroup shares before it reads it.
    let options = wgpu::PipelineCompilationOptions {
        zero_initialize_workgroup_memory: false,
        ..Default::default()
    };
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(name),
        layout: Some(layout),
        module: &module,
        entry_point: Some("main"),
        compilation_options: options,
        cache: None,
    })
}

fn layout(device: &wgpu::Device, [read, written]: [usize; 2]) -> Layout {
    let entry = |binding: usize, kind, has_dynamic_offset| wgpu::BindGroupLayoutEntry {
        binding: binding as u32,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty: kind,
            has_dynamic_offset,
            min_binding_size: None,
        },
        count: None,
    };
    let array = |at| {
        entry(
            1 + at,
            wgpu::BufferBindingType::Storage {
                read_only: at < read,
            },
            false,
        )
    };
    let parameters = entry(0, wgpu::BufferBindingType::Uniform, true);
    let entries: Vec<_> = std::iter::once(parameters)
        .chain((0..read + written).map(array))
        .collect();
    let group = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: None,
        entries: &entries,
    });
    let descriptor = wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &[Some(&group)],
        immediate_size: 0,
    };
    let pipeline = device.create_pipeline_layout(&descriptor);
    Layout { group, pipeline }
}
