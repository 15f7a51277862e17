//! Convolution as an implicit product, and its gradients: each reads its factors where they lie.

use super::geometry::Geometry;
use crate::ops::product::finish::Finish;
use crate::ops::product::gpu::product::{Along, Images, Product};
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::factor::Factor;
use crate::runtime::gpu::pool::Buffer;

fn product<'a>(
    factors: &'static str,
    name: &'static str,
    a: Factor<'a>,
    b: Factor<'a>,
    g: &Geometry,
) -> Product<'a> {
    Product {
        factors,
        name,
        images: Some(images(g)),
        kernel: g.kernel,
        ..Product::dense(a, b, [0; 3], [0; 4])
    }
}

fn images(g: &Geometry) -> Images {
    let [top, _, left, _] = g.conv.pad;
    Images {
        channels: g.channels,
        height: g.height,
        width: g.width,
        out_height: g.out_height,
        out_width: g.out_width,
        stride: g.conv.stride,
        top,
        left,
    }
}

/// `x` convolved with `weight`, plus `bias`, finished.
pub fn forward(
    gpu: &Gpu,
    x: &Buffer,
    weight: Factor,
    bias: Option<&Buffer>,
    finish: Finish<&Buffer>,
    g: &Geometry,
) -> Buffer {
    let product = forward_product(x, weight, bias, g);
    Product { finish, ..product }.run(gpu)
}

/// The product that this is.
pub fn forward_product<'a>(
    x: &'a Buffer,
    weight: Factor<'a>,
    bias: Option<&'a Buffer>,
    g: &Geometry,
) -> Product<'a> {
    let depth = g.channels * g.kernel[0] * g.kernel[1];
    let pixels = g.out_height * g.out_width;
    Product {
        bias: bias.map(|bias| (bias, Along::Rows)),
        extents: [g.outputs, depth, g.batch * pixels],
        // Weights lie along the depth; images along their pixels, which are the columns.
        depth_first: [true, false],
        pixels,
        strides: [depth, 1, 0, 0],
        ..product(include_str!("conv.wgsl"), "conv", weight, x.into(), g)
    }
}

/// The gradient to the input.
pub fn backward_input(gpu: &Gpu, dy: &Buffer, weight: Factor, g: &Geometry) -> Buffer {
    let taps = g.kernel[0] * g.kernel[1];
    let pixels = g.height * g.width;
    let factors = include_str!("conv_backward_input.wgsl");
    let product = Product {
        images: Some(Images {
            channels: g.outputs,
            ..images(g)
        }),
        extents: [g.channels, g.outputs * taps, g.batch * pixels],
        depth_first: [true, false],
        pixels,
        strides: [0, g.channels * taps, 0, 0],
        ..product(factors, "conv_backward_input", weight, dy.into(), g)
    };
    product.run(gpu)
}

/// The gradient to the weight.
pub fn backward_weight(gpu: &Gpu, x: &Buffer, dy: &Buffer, g: &Geometry) -> Buffer {
    let columns = g.channels * g.kernel[0] * g.kernel[1];
    let factors = include_str!("conv_backward_weight.wgsl");
    let product = Product {
        extents: [g.outputs, g.batch * g.out_height * g.out_width, columns],
        depth_first: [true, true],
        pixels: columns,
        ..product(factors, "conv_backward_weight", dy.into(), x.into(), g)
    };
    product.run(gpu)
}
