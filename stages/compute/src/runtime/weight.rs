//! Frozen weights: `f32` arrays, or 16-bit numbers that operators widen piece by piece. It knows
//! how numbers are stored, not what a weight is for.

use std::fmt;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use super::array::Array;
use super::cpu::buffer::HostBuffer;
use super::cpu::values::Values;
use super::device::{Backend, Device};
use super::gpu::context::Gpu;
use super::gpu::factor::Factor;
use super::gpu::pool;

pub use super::format::{Format, Precision};

/// Bytes that outlive the weights cut from them: a memory map, or a vector.
pub type SharedBytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// An immutable weight, in row-major order. A clone shares the numbers. Operators that take `impl
/// Into<Weight>` also take `&Array` and `&Weight`.
#[derive(Clone)]
pub struct Weight {
    shape: Arc<[usize]>,
    storage: Storage,
    precision: Precision,
    /// Where the CPU keeps its transformed kernels, if it is to.
    transformed: Option<Arc<OnceLock<HostBuffer>>>,
}

#[derive(Clone)]
enum Storage {
    Array(Array),
    Bytes(Encoded),
}

/// Numbers in the bytes `range` of `owner`, which are never copied as a whole.
#[derive(Clone)]
pub(crate) struct Encoded {
    device: Device,
    format: Format,
    owner: SharedBytes,
    range: Range<usize>,
    /// The bytes in the memory of a GPU, once a kernel has asked for them.
    copy: Arc<OnceLock<pool::Buffer>>,
}

impl Encoded {
    fn bytes(&self) -> &[u8] {
        &(*self.owner).as_ref()[self.range.clone()]
    }

    /// The values as the CPU's kernels read them.
    fn values(&self) -> Values<'_> {
        Values::new(self.format, self.bytes())
    }
}

impl Weight {
    /// The numbers in the bytes `range` of `owner`, which is kept alive and not copied.
    /// Panics if `range` is not `shape`'s number of elements long, or lies beyond the bytes.
    pub fn from_bytes(
        device: &Device,
        shape: &[usize],
        format: Format,
        owner: SharedBytes,
        range: Range<usize>,
    ) -> Weight {
        let expected = shape.iter().product::<usize>() * format.width();
        let held = (*owner).as_ref().len();
        assert_eq!(
            range.len(),
            expected,
            "weight: {range:?} does not fill the shape {shape:?} of {format:?}"
        );
        assert!(
            range.end <= held,
            "weight: {range:?} lies beyond {held} bytes"
        );
        let device = device.clone();
        let storage = Storage::Bytes(Encoded {
            device,
            format,
            owner,
            range,
            // Filled by the first kernel that asks: a weight that is not used takes no device
            // memory.
            copy: Arc::default(),
        });
        Weight {
            shape: shape.into(),
            storage,
            precision: Precision::default(),
            transformed: None,
        }
    }

    /// The extents of the axes, outermost first.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The device that computes with the weight.
    pub fn device(&self) -> &Device {
        match &self.storage {
            Storage::Array(array) => array.device(),
            Storage::Bytes(encoded) => &encoded.device,
        }
    }

    /// How the numbers are stored.
    pub fn format(&self) -> Format {
        match &self.storage {
            Storage::Array(_) => Format::F32,
            Storage::Bytes(encoded) => encoded.format,
        }
    }

    /// Sets the precision that factors are rounded to in products.
    pub fn with_precision(self, precision: Precision) -> Weight {
        Weight { precision, ..self }
    }

    /// Lets the CPU keep the transforms of a 3x3 convolution once it has needed them: for networks
    /// that run often, and can spare four times what the numbers take in `f32`. Clones share them.
    pub fn keeping_transforms(self) -> Weight {
        Weight {
            transformed: Some(Arc::default()),
            ..self
        }
    }

    /// How products with the weight are computed.
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// All numbers, widened into an array; a new one unless the weight was made of one.
    pub fn to_array(&self) -> Array {
        match &self.storage {
            Storage::Array(array) => array.clone(),
            Storage::Bytes(encoded) => match encoded.device.backend() {
                Backend::Cpu => Array::on_cpu(&self.shape, encoded.values().to_buffer()),
                Backend::Gpu(_) => encoded
                    .device
                    .array(&self.shape, encoded.values().to_buffer().to_vec()),
            },
        }
    }

    /// These numbers under another shape of as many elements, without a copy. Panics if it has more
    /// or fewer.
    pub fn reshape(&self, shape: &[usize]) -> Weight {
        let [old, new] = [&self.shape, shape].map(|shape| shape.iter().product::<usize>());
        assert_eq!(old, new, "weight: {:?} does not fit {shape:?}", self.shape);
        Weight {
            shape: shape.into(),
            // Transformed kernels belong to the old shape.
            transformed: None,
            ..self.clone()
        }
    }

    /// The place and value of the first element that is infinite or not a number.
    pub fn first_not_finite(&self) -> Option<(usize, f32)> {
        match &self.storage {
            Storage::Array(array) => Values::F32(&array.to_vec()).first_not_finite(),
            Storage::Bytes(encoded) => encoded.values().first_not_finite(),
        }
    }

    /// The values for GPU kernels only; at the first call, they are copied to the device in the
    /// format that they have.
    pub(crate) fn factor(&self, gpu: &Gpu) -> Factor<'_> {
        match &self.storage {
            Storage::Array(array) => array.device_buffer().into(),
            Storage::Bytes(encoded) => Factor {
                // Widened on the way into a kernel's registers: device memory holds half as much.
                numbers: encoded.copy.get_or_init(|| gpu.upload(encoded.bytes())),
                format: encoded.format,
            },
        }
    }

    /// The array that the weight was made of, unless that was bytes.
    pub(crate) fn array(&self) -> Option<&Array> {
        match &self.storage {
            Storage::Array(array) => Some(array),
            Storage::Bytes(_) => None,
        }
    }

    /// The place for transformed kernels, for CPU kernels only.
    pub(crate) fn transformed(&self) -> Option<&OnceLock<HostBuffer>> {
        self.transformed.as_deref()
    }

    /// The values in host memory: of an array on a GPU, there are none.
    pub(crate) fn host(&self) -> Values<'_> {
        match &self.storage {
            Storage::Array(array) => Values::F32(array.host()),
            Storage::Bytes(encoded) => encoded.values(),
        }
    }
}

impl From<Array> for Weight {
    fn from(array: Array) -> Weight {
        Weight {
            shape: array.shape().into(),
            storage: Storage::Array(array),
            precision: Precision::default(),
            transformed: None,
        }
    }
}

impl From<&Array> for Weight {
    fn from(array: &Array) -> Weight {
        array.clone().into()
    }
}

impl From<&Weight> for Weight {
    fn from(weight: &Weight) -> Weight {
        weight.clone()
    }
}

impl fmt::Debug for Weight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "Weight{:?} of {:?} on {}",
            self.shape,
            self.format(),
            self.device().kind()
        )
    }
}

/// The extents of a two-axis weight `[rows, columns]`.
pub(crate) fn matrix(op: &str, weight: &Weight) -> [usize; 2] {
    match *weight.shape() {
        [rows, columns] => [rows, columns],
        _ => panic!(
            "{op}: expected a weight [rows, columns], got {:?}",
            weight.shape()
        ),
    }
}

/// The extents of a convolution's weight `[O, C, kh, kw]`.
pub(crate) fn kernels(op: &str, weight: &Weight) -> [usize; 4] {
    match *weight.shape() {
        [o, c, kh, kw] => [o, c, kh, kw],
        _ => panic!(
            "{op}: expected a weight [O, C, kh, kw], got {:?}",
            weight.shape()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "weight: 0..8 does not fill the shape [2, 3] of F16")]
    fn bytes_that_do_not_fill_the_shape_are_refused() {
        let bytes = Arc::new(vec![0; 8]);
        Weight::from_bytes(&Device::cpu(), &[2, 3], Format::F16, bytes, 0..8);
    }
}
