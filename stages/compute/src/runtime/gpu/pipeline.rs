//! Pipelines that can be started, each compiled once. It knows how their arrays are bound, not what
//! they compute.

use std::collections::BTreeMap;

use super::kernel::{KernelSource, Pieces};

/// The layouts that kernels of equally many arrays share.
struct Layout {
    group: wgpu::BindGroupLayout,
    pipeline: wgpu::PipelineLayout,
}

/// A kernel that can be started.
#[derive(Clone)]
pub struct Pipeline {
    /// The compiled code.
    pub code: wgpu::ComputePipeline,
    /// How its arrays are bound.
    pub group: wgpu::BindGroupLayout,
}

/// All kernels of one device.
#[derive(Default)]
pub struct Pipelines {
    layouts: BTreeMap<[usize; 2], Layout>,
    /// Of each source, for arrays in so many pieces.
    pipelines: BTreeMap<KernelSource, BTreeMap<Vec<u32>, Pipeline>>,
}

impl Pipelines {
    /// The pipeline of `source`, compiled at the first call; `None` if its arrays cannot lie in
    /// such pieces.
    pub fn get(
        &mut self,
        device: &wgpu::Device,
        source: &KernelSource,
        pieces: &Pieces,
    ) -> Option<Pipeline> {
        // The counts alone tell pieces apart: a device has one window.
        let known = self.pipelines.get(source);
        if let Some(pipeline) = known.and_then(|known| known.get(&pieces.counts)) {
            return Some(pipeline.clone());
        }
        let text = source.text(pieces)?;
        let bindings = source.bindings(pieces);
        let layout = self
            .layouts
            .entry(bindings)
            .or_insert_with(|| layout(device, bindings));
        let pipeline = Pipeline {
            code: compile(device, source.name, text, &layout.pipeline),
            group: layout.group.clone(),
        };
        let known = self.pipelines.entry(source.clone()).or_default();
        known.insert(pieces.counts.clone(), pipeline.clone());
        Some(pipeline)
    }

    /// How many were compiled.
    pub fn count(&self) -> u64 {
        self.pipelines
            .values()
            .map(|known| known.len() as u64)
            .sum()
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
    // A dynamic offset: all commands of a batch share one buffer of parameters.
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
