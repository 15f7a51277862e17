//! The one data type: a contiguous row-major `f32` array. It knows its shape and its device, not
//! what its axes mean.

use std::fmt;
use std::sync::Arc;

use super::cpu::buffer::HostBuffer;
use super::device::{Backend, Device};
use super::gpu::context::Gpu;
use super::gpu::each::fill;
use super::gpu::pool;

/// An immutable `f32` array on a [`Device`], contiguous and row-major. A clone shares the values.
#[derive(Clone)]
pub struct Array {
    device: Device,
    shape: Arc<[usize]>,
    storage: Storage,
}

#[derive(Clone)]
enum Storage {
    Cpu(Arc<HostBuffer>),
    Gpu(Arc<pool::Buffer>),
}

impl Array {
    /// An array in host memory.
    pub(crate) fn on_cpu(shape: &[usize], values: impl Into<HostBuffer>) -> Array {
        let values = values.into();
        let expected: usize = shape.iter().product();
        assert_eq!(
            values.len(),
            expected,
            "array: {} values do not fill the shape {shape:?}",
            values.len()
        );
        Array {
            device: Device::cpu(),
            shape: shape.into(),
            storage: Storage::Cpu(Arc::new(values)),
        }
    }

    /// An array in the memory of a GPU.
    pub(crate) fn on_gpu(gpu: &Arc<Gpu>, shape: &[usize], values: pool::Buffer) -> Array {
        Array {
            device: Device::of(gpu),
            shape: shape.into(),
            storage: Storage::Gpu(Arc::new(values)),
        }
    }

    /// The extents of the axes, outermost first.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The extent of the last axis; 1 for a scalar.
    pub(crate) fn last(&self) -> usize {
        self.shape.last().copied().unwrap_or(1)
    }

    /// The number of elements.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether the array has no elements.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The device the values lie on.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Copies the values to the host; on a GPU, once all that they depend on is computed.
    pub fn to_vec(&self) -> Vec<f32> {
        match &self.storage {
            Storage::Cpu(values) => values.to_vec(),
            Storage::Gpu(values) => self.device.gpu_context().read(values, self.len()),
        }
    }

    /// These values under another shape of as many elements, without a copy. Panics if it has more
    /// or fewer.
    pub fn reshape(&self, shape: &[usize]) -> Array {
        let expected: usize = shape.iter().product();
        assert_eq!(
            self.len(),
            expected,
            "reshape: {:?} does not fit {shape:?}",
            self.shape
        );
        Array {
            shape: shape.into(),
            // The values are behind an `Arc`: nothing is copied.
            ..self.clone()
        }
    }

    /// The values in host memory, for CPU kernels only.
    pub(crate) fn host(&self) -> &[f32] {
        match &self.storage {
            Storage::Cpu(values) => values,
            Storage::Gpu(_) => panic!("{self:?} meets an array on the CPU"),
        }
    }

    /// The values in host memory to change in place; copied first if another array shares them.
    pub(crate) fn host_mut(&mut self) -> &mut [f32] {
        match &mut self.storage {
            Storage::Cpu(values) => {
                // Copies only if a clone shares the values, so that an array given away never
                // changes.
                let buffer: &mut HostBuffer = Arc::make_mut(values);
                buffer
            }
            Storage::Gpu(_) => panic!("an array on a GPU is not changed in place"),
        }
    }

    /// The values in the memory of a GPU, for GPU kernels only.
    pub(crate) fn device_buffer(&self) -> &pool::Buffer {
        match &self.storage {
            Storage::Gpu(values) => values,
            Storage::Cpu(_) => panic!("{self:?} meets an array on a GPU"),
        }
    }
}

impl Device {
    /// Moves `values` (row-major) to this device. Panics if their number is not the product of
    /// `shape`.
    pub fn array(&self, shape: &[usize], values: Vec<f32>) -> Array {
        match self.backend() {
            Backend::Cpu => Array::on_cpu(shape, values),
            Backend::Gpu(gpu) => {
                let expected: usize = shape.iter().product();
                assert_eq!(
                    values.len(),
                    expected,
                    "array: {} values do not fill the shape {shape:?}",
                    values.len()
                );
                Array::on_gpu(gpu, shape, gpu.upload(bytemuck::cast_slice(&values)))
            }
        }
    }

    /// An array of zeros.
    pub fn zeros(&self, shape: &[usize]) -> Array {
        self.full(shape, 0.0)
    }

    /// An array with every element equal to `value`.
    pub fn full(&self, shape: &[usize], value: f32) -> Array {
        let len = shape.iter().product();
        match self.backend() {
            Backend::Cpu => Array::on_cpu(shape, vec![value; len]),
            Backend::Gpu(gpu) => Array::on_gpu(gpu, shape, fill(gpu, len, value)),
        }
    }
}

impl fmt::Debug for Array {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Array{:?} on {}", self.shape, self.device.kind())
    }
}

/// The extents of a four-axis array `[N, C, H, W]`; `op` names the caller in the message.
pub(crate) fn nchw(op: &str, x: &Array) -> [usize; 4] {
    match *x.shape() {
        [n, c, h, w] => [n, c, h, w],
        _ => panic!("{op}: expected [N, C, H, W], got {:?}", x.shape()),
    }
}

/// The extents of a two-axis array `[rows, columns]`.
pub(crate) fn matrix(op: &str, x: &Array) -> [usize; 2] {
    match *x.shape() {
        [rows, columns] => [rows, columns],
        _ => panic!("{op}: expected [rows, columns], got {:?}", x.shape()),
    }
}

/// Asserts that two arrays have the same shape.
pub(crate) fn same_shape(op: &str, a: &Array, b: &Array) {
    assert_eq!(a.shape(), b.shape(), "{op}: the shapes differ");
}

/// Asserts that `x` holds one value for each of `count` things.
pub(crate) fn vector(op: &str, what: &str, x: &Array, count: usize) {
    assert_eq!(
        x.len(),
        count,
        "{op}: {what} has shape {:?}, expected {count} values",
        x.shape()
    );
}
