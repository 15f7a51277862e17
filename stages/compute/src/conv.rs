//! Two-dimensional convolution (cross-correlation, as networks mean it) and its gradients. It knows images as
//! `[N, C, H, W]` and weights as `[O, C, kh, kw]`.

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
        let (padded_height, padded_width) = (height + top + bottom, width + left + right);
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
    let weight = weight.into();
    let ([_, c, _, _], [o, wc, kh, kw]) = (nchw("conv2d", x), kernels("conv2d", &weight));
    assert_eq!(
        c,
        wc,
        "conv2d: input {:?} and weight {:?}",
        x.shape(),
        weight.shape()
    );
    let geometry = Geometry::new("conv2d", nchw("conv2d", x), o, [kh, kw], conv);
    if let Some(bias) = bias {
        vector("conv2d", "bias", bias, o);
    }
    match x.device().backend() {
        Backend::Cpu => {
            let values = cpu::conv::forward(
                x.host(),
                (weight.host(), weight.precision()),
                bias.map(Array::host),
                &geometry,
            );
            Array::on_cpu(
                &[geometry.batch, o, geometry.out_height, geometry.out_width],
                values,
            )
        }
        Backend::Gpu(gpu) => {
            let bias = bias.map(Array::device_buffer);
            let values =
                gpu::conv::forward(gpu, x.device_buffer(), weight.factor(gpu), bias, &geometry);
            Array::on_gpu(
                gpu,
                &[geometry.batch, o, geometry.out_height, geometry.out_width],
                values,
            )
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
    let (op, weight) = ("conv2d_backward_input", weight.into());
    let ([n, _, _, _], [o, c, kh, kw]) = (nchw(op, dy), kernels(op, &weight));
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
    let ([_, c, _, _], [_, o, _, _]) = (nchw(op, x), nchw(op, dy));
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
