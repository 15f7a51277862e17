//! Two-dimensional convolution (cross-correlation, as networks mean it) and its gradients. It knows
//! images as `[N, C, H, W]` and weights as `[O, C, kh, kw]`.

use crate::array::{Array, nchw, vector};
use crate::cpu;
use crate::device::Backend;
use crate::gpu;
use crate::weight::{Weight, kernels};

/// How a convolution walks over its input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conv {
    /// Step between neighbouring outputs, in input pixels, both ways.
    pub stride: usize,
    /// Zeros around the input: top, bottom, left, right.
    pub pad: [usize; 4],
}

impl Default for Conv {
    /// Stride 1, no padding.
    fn default() -> Conv {
        Conv {
            stride: 1,
            pad: [0; 4],
        }
    }
}

impl Conv {
    /// Stride 1 with `pad` zeros on every side.
    pub fn padded(pad: usize) -> Conv {
        Conv {
            stride: 1,
            pad: [pad; 4],
        }
    }
}

/// What becomes of a convolution's results before they are stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finish<T> {
    /// Nothing.
    None,
    /// `x` above 0, this slope times `x` below.
    Leaky(f32),
    /// The sum with another array of the same shape.
    Add(T),
}

impl<T> Finish<T> {
    /// The same with the other array as someone else sees it.
    pub(crate) fn map<U>(self, see: impl FnOnce(T) -> U) -> Finish<U> {
        match self {
            Finish::None => Finish::None,
            Finish::Leaky(slope) => Finish::Leaky(slope),
            Finish::Add(other) => Finish::Add(see(other)),
        }
    }
}

/// All extents of one convolution.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Geometry {
    pub batch: usize,
    pub channels: usize,
    pub height: usize,
    pub width: usize,
    pub outputs: usize,
    pub kernel: [usize; 2],
    pub conv: Conv,
    pub out_height: usize,
    pub out_width: usize,
}

impl Geometry {
    fn new(
        op: &str,
        input: [usize; 4],
        outputs: usize,
        kernel: [usize; 2],
        conv: Conv,
    ) -> Geometry {
        let [batch, channels, height, width] = input;
        let [top, bottom, left, right] = conv.pad;
        let padded_height = height + top + bottom;
        let padded_width = width + left + right;
        assert!(
            conv.stride > 0 && kernel[0] > 0 && kernel[1] > 0,
            "{op}: stride and kernel must be positive"
        );
        assert!(
            padded_height >= kernel[0] && padded_width >= kernel[1],
            "{op}: the kernel {kernel:?} exceeds the padded input {padded_height}x{padded_width}"
        );
        let out_height = (padded_height - kernel[0]) / conv.stride + 1;
        let out_width = (padded_width - kernel[1]) / conv.stride + 1;
        Geometry {
            batch,
            channels,
            height,
            width,
            outputs,
            kernel,
            conv,
            out_height,
            out_width,
        }
    }

    fn expect_output(&self, op: &str, dy: &Array) {
        let expected = [self.batch, self.outputs, self.out_height, self.out_width];
        assert_eq!(
            dy.shape(),
            expected,
            "{op}: the gradient's shape does not belong to this convolution"
        );
    }
}

/// Convolves `x [N, C, H, W]` with `weight [O, C, kh, kw]` and adds `bias [O]`: `[N, O, H', W']`.
pub fn conv2d(x: &Array, weight: impl Into<Weight>, bias: Option<&Array>, conv: Conv) -> Array {
    conv2d_finished(x, weight, bias, conv, Finish::None)
}

/// The same, and finished before it is stored; what is added has the result's shape.
pub fn conv2d_finished(
    x: &Array,
    weight: impl Into<Weight>,
    bias: Option<&Array>,
    conv: Conv,
    finish: Finish<&Array>,
) -> Array {
    let weight = weight.into();
    let [n, c, height, width] = nchw("conv2d", x);
    let [o, wc, kh, kw] = kernels("conv2d", &weight);
    assert_eq!(
        c,
        wc,
        "conv2d: input {:?} and weight {:?}",
        x.shape(),
        weight.shape()
    );
    let g = Geometry::new("conv2d", [n, c, height, width], o, [kh, kw], conv);
    if let Some(bias) = bias {
        vector("conv2d", "bias", bias, o);
    }
    let shape = [n, o, g.out_height, g.out_width];
    if let Finish::Add(other) = finish {
        assert_eq!(
            other.shape(),
            shape,
            "conv2d: what is added has another shape"
        );
    }
    match x.device().backend() {
        Backend::Cpu => {
            let bias = bias.map(Array::host);
            let finish = finish.map(Array::host);
            let values = cpu::conv::forward(x.host(), &weight, bias, finish, &g);
            Array::on_cpu(&shape, values)
        }
        Backend::Gpu(gpu) => {
            let bias = bias.map(Array::device_buffer);
            let finish = finish.map(Array::device_buffer);
            let weight = weight.factor(gpu);
            let values = gpu::conv::forward(gpu, x.device_buffer(), weight, bias, finish, &g);
            Array::on_gpu(gpu, &shape, values)
        }
    }
}

/// The gradient of [`conv2d`] to its input, whose height and width are `size`: `[N, C, H, W]`.
pub fn conv2d_backward_input(
    dy: &Array,
    weight: impl Into<Weight>,
    conv: Conv,
    size: [usize; 2],
) -> Array {
    let op = "conv2d_backward_input";
    let weight = weight.into();
    let [n, _, _, _] = nchw(op, dy);
    let [o, c, kh, kw] = kernels(op, &weight);
    let geometry = Geometry::new(op, [n, c, size[0], size[1]], o, [kh, kw], conv);
    geometry.expect_output(op, dy);
    match dy.device().backend() {
        Backend::Cpu => {
            let values = cpu::conv::backward_input(
                dy.host(),
                (weight.host(), weight.precision()),
                &geometry,
            );
            Array::on_cpu(&[n, c, size[0], size[1]], values)
        }
        Backend::Gpu(gpu) => {
            let values =
                gpu::conv::backward_input(gpu, dy.device_buffer(), weight.factor(gpu), &geometry);
            Array::on_gpu(gpu, &[n, c, size[0], size[1]], values)
        }
    }
}

/// The gradient of [`conv2d`] to its weight, with `kernel` = `[kh, kw]`: `[O, C, kh, kw]`.
pub fn conv2d_backward_weight(x: &Array, dy: &Array, conv: Conv, kernel: [usize; 2]) -> Array {
    let op = "conv2d_backward_weight";
    let [_, c, _, _] = nchw(op, x);
    let [_, o, _, _] = nchw(op, dy);
    let geometry = Geometry::new(op, nchw(op, x), o, kernel, conv);
    geometry.expect_output(op, dy);
    match x.device().backend() {
        Backend::Cpu => Array::on_cpu(
            &[o, c, kernel[0], kernel[1]],
            cpu::conv::backward_weight(x.host(), dy.host(), &geometry),
        ),
        Backend::Gpu(gpu) => {
            let values =
                gpu::conv::backward_weight(gpu, x.device_buffer(), dy.device_buffer(), &geometry);
            Array::on_gpu(gpu, &[o, c, kernel[0], kernel[1]], values)
        }
    }
}
