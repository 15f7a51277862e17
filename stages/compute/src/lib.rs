//! Arrays on a device, and operators with explicit forward and backward.
//!
//! An operator is a pure function of [`Array`]s. It checks shapes, picks the kernel of the device
//! its inputs lie on, and returns a new array; its gradient stands beside it under the same name.
//! Nothing here knows networks or files. Each operator is a folder in `ops`; what they share
//! (arrays, weights, vectors, kernels, pools) is in `runtime`, which knows no operator.
//!
//! Same inputs give the same bits for any number of threads: work is cut into chunks whose size
//! never depends on the thread count, and every reduction runs in a fixed order. Another processor
//! may round matrix products differently.
//!
//! A frozen weight may stay in 16 bits, in memory or in a mapped file: [`linear::linear`],
//! [`linear::linear_backward_input`], [`conv::conv2d`], [`conv::conv2d_backward_input`] and
//! [`shape::gather_rows`] take `impl Into<Weight>`, that is `&Array`, `&Weight` or either by value.
//! [`Weight::from_bytes`] makes one of bytes that it shares, [`Weight::stored`] refuses bad numbers
//! without widening all of them at once, and [`Weight::with_precision`] has it multiplied
//! in bf16.
//!
//! On a GPU ([`Device::gpu`]) operators record commands and return at once; [`Array::to_vec`] and
//! the reductions to one number wait. The same adapter and driver give the same bits. A fault of
//! the device unwinds to [`device::attempt`].
//!
//! On the CPU, kernels are compiled for several widths of vectors, and the widest that the
//! processor has is taken when the program runs; the environment variable `COMPUTE_SIMD`
//! (`portable` or `avx2`) limits it. Maps and reductions give the same bits at every width, matrix
//! products do not.
//!
//! ```
//! use compute::Device;
//! use compute::linear::{linear, linear_backward_input};
//!
//! let device = Device::cpu();
//! let x = device.array(&[1, 2], vec![1.0, 2.0]); // [N, K]
//! let weight = device.array(&[3, 2], vec![1.0, 0.0, 0.0, 1.0, 1.0, 1.0]); // [M, K]
//! let y = linear(&x, &weight, None); // [N, M]
//! assert_eq!(y.to_vec(), [1.0, 2.0, 3.0]);
//! let dx = linear_backward_input(&y, &weight);
//! assert_eq!(dx.to_vec(), [4.0, 5.0]);
//! ```

#[cfg(test)]
mod check;
#[cfg(test)]
mod levels;
mod ops;
mod runtime;

pub mod kernels;
#[doc(hidden)]
pub mod testing;

pub use ops::elementwise::{activation, reduce};
pub use ops::product::{linear, matmul};
pub use ops::{adam, attention, conv, elementwise, norm, resize, shape};
pub use runtime::array::{self, Array};
pub use runtime::device::{self, Counts, Device, GpuError};
pub use runtime::rng::{self, Rng};
pub use runtime::stored::StoredFault;
pub use runtime::weight::{self, Format, Precision, Weight};
