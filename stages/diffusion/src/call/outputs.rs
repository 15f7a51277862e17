//! Named results, and the safetensors file of them: sorted by name, the same bytes for the same
//! values.

use std::collections::BTreeMap;

use compute::Array;
use formats::tensor_file::{self, WriteError};
use formats::{TensorView, Values};

/// One tensor that a part gives.
#[derive(Clone, Debug)]
pub enum Output {
    /// Numbers in `f32`, on the device that computed them.
    Real(Array),
    /// `i64`, with a shape.
    Whole(Vec<usize>, Vec<i64>),
}

/// Tensors by the names of diffusers' results.
pub type Outputs = BTreeMap<String, Output>;

impl Output {
    /// The extents of the axes.
    pub fn shape(&self) -> &[usize] {
        match self {
            Self::Real(array) => array.shape(),
            Self::Whole(shape, _) => shape,
        }
    }
}

/// The safetensors file of `outputs`.
///
/// # Errors
/// Names that safetensors keeps for itself.
pub fn to_safetensors(outputs: &Outputs) -> Result<Vec<u8>, WriteError> {
    // Views borrow their numbers, so what is copied from a device must outlive all of them.
    let host: Vec<Host> = outputs.values().map(Host::of).collect();
    let views = outputs.iter().zip(&host);
    let views = views.map(|((name, output), host)| (name.as_str(), host.view(output.shape())));
    tensor_file::to_bytes(&views.collect(), &BTreeMap::new())
}

/// A result in the host's memory.
enum Host<'a> {
    Real(Vec<f32>),
    Whole(&'a [i64]),
}

impl<'a> Host<'a> {
    fn of(output: &'a Output) -> Self {
        match output {
            Output::Real(array) => Self::Real(array.to_vec()),
            Output::Whole(_, values) => Self::Whole(values),
        }
    }

    fn view<'b>(&'b self, shape: &'b [usize]) -> TensorView<'b> {
        let values = match self {
            Self::Real(values) => Values::F32(values),
            Self::Whole(values) => Values::I64(values),
        };
        TensorView { shape, values }
    }
}
