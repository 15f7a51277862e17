//! Commands that wait to be handed over together. It knows passes, parameters and copies, not what
//! kernels compute.

use super::pipeline::Pipeline;

/// Bytes between the parameters of two commands: the alignment that every adapter takes.
const SLOT: usize = 256;
/// Commands that are handed over at once: a pass through a network is a few such batches.
const BATCH: usize = 256;

/// What a kernel sees of an array at one of its bindings.
#[derive(Clone, Copy)]
pub struct Piece<'b> {
    /// The buffer that the array lies in.
    pub buffer: &'b wgpu::Buffer,
    /// Where the piece begins.
    pub offset: u64,
    /// How long it is.
    pub bytes: u64,
}

impl<'b> Piece<'b> {
    fn entry(&self, binding: usize) -> wgpu::BindGroupEntry<'b> {
        let buffer = self.buffer;
        let offset = self.offset;
        let size = wgpu::BufferSize::new(self.bytes);
        let resource = wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer,
            offset,
            size,
        });
        wgpu::BindGroupEntry {
            binding: binding as u32,
            resource,
        }
    }
}

/// Commands not handed over yet.
pub struct Recorder {
    // The order matters: the pass ends before its encoder does.
    pass: Option<wgpu::ComputePass<'static>>,
    encoder: Option<wgpu::CommandEncoder>,
    /// The parameters of each command, a slot each.
    slots: Vec<u8>,
    parameters: wgpu::Buffer,
}

impl Recorder {
    /// A recorder without commands, and room for the parameters of one batch.
    pub fn new(device: &wgpu::Device) -> Recorder {
        let parameters = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("parameters"),
            size: (SLOT * BATCH) as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Recorder {
            pass: None,
            encoder: None,
            slots: Vec::new(),
            parameters,
        }
    }

    /// Whether no further command fits.
    pub fn is_full(&self) -> bool {
        self.slots.len() >= SLOT * BATCH
    }

    /// Records one kernel over `groups` workgroups; `pieces` of its arrays are in the order of its
    /// bindings.
    pub fn dispatch(
        &mut self,
        device: &wgpu::Device,
        pipeline: &Pipeline,
        pieces: &[Piece],
        params: &[u8],
        groups: [u32; 3],
    ) {
        let offset = self.slots.len();
        assert!(
            params.len() <= SLOT,
            "a kernel's parameters have at most {SLOT} bytes"
        );
        self.slots.extend_from_slice(params);
        // Slots are apart by the alignment, whatever the parameters' length.
        self.slots.resize(offset + SLOT, 0);
        let group = bind(device, pipeline, &self.parameters, pieces);
        let encoder = self
            .encoder
            .get_or_insert_with(|| device.create_command_encoder(&Default::default()));
        let pass = self.pass.get_or_insert_with(|| {
            encoder
                // One pass for many commands. Its lifetime is ours to keep: see the fields' order.
                .begin_compute_pass(&Default::default())
                .forget_lifetime()
        });
        pass.set_pipeline(&pipeline.code);
        pass.set_bind_group(0, &group, &[offset as u32]);
        pass.dispatch_workgroups(groups[0], groups[1], groups[2]);
    }

    /// Records a copy of the first `bytes` of one buffer into another.
    pub fn copy(
        &mut self,
        device: &wgpu::Device,
        from: &wgpu::Buffer,
        to: &wgpu::Buffer,
        bytes: u64,
    ) {
        // A copy cannot be recorded within a pass.
        self.pass = None;
        let encoder = self
            .encoder
            .get_or_insert_with(|| device.create_command_encoder(&Default::default()));
        encoder.copy_buffer_to_buffer(from, 0, to, 0, bytes);
    }

    /// Hands all over, if there is anything.
    pub fn submit(&mut self, queue: &wgpu::Queue) -> Option<wgpu::SubmissionIndex> {
        self.pass = None;
        let encoder = self.encoder.take()?;
        if !self.slots.is_empty() {
            // Queued behind the batch before, which still reads its own.
            queue.write_buffer(&self.parameters, 0, &self.slots);
            self.slots.clear();
        }
        Some(queue.submit([encoder.finish()]))
    }
}

fn bind(
    device: &wgpu::Device,
    pipeline: &Pipeline,
    parameters: &wgpu::Buffer,
    pieces: &[Piece],
) -> wgpu::BindGroup {
    let parameters = Piece {
        buffer: parameters,
        offset: 0,
        // One slot: the dynamic offset says which.
        bytes: SLOT as u64,
    };
    let entries: Vec<_> = std::iter::once(&parameters)
        .chain(pieces)
        .enumerate()
        .map(|(at, piece)| piece.entry(at))
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.group,
        entries: &entries,
    })
}
