//! The extents of a convolution: what it walks over, and how. It knows no values.

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
pub struct Geometry {
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
    /// Panics, in the name of `op`, where the kernel does not fit the input.
    pub fn new(
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
        // Rounded down, as in PyTorch: pixels behind the last whole step are not seen.
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

    /// Panics unless a gradient of shape `dy` belongs to this convolution's output.
    pub fn expect_output(&self, op: &str, dy: &[usize]) {
        let expected = [self.batch, self.outputs, self.out_height, self.out_width];
        assert_eq!(
            dy, expected,
            "{op}: the gradient's shape does not belong to this convolution"
        );
    }

    /// Elements of a kernel.
    pub fn taps(&self) -> usize {
        self.kernel[0] * self.kernel[1]
    }

    /// Pixels of an output channel.
    pub fn pixels(&self) -> usize {
        self.out_height * self.out_width
    }

    /// Pixels of an input channel.
    pub fn plane(&self) -> usize {
        self.height * self.width
    }

    /// Whether the column matrix is the image itself.
    pub fn is_pointwise(&self) -> bool {
        self.kernel == [1, 1] && self.conv == Conv::default()
    }

    /// This convolution on images of a single row, if it is [pointwise](Self::is_pointwise).
    pub fn flat(&self) -> Geometry {
        if !self.is_pointwise() {
            return *self;
        }
        Geometry {
            height: 1,
            width: self.plane(),
            out_height: 1,
            out_width: self.pixels(),
            ..*self
        }
    }

    /// The convolution by which gradients flow back, if that is one: of stride 1, with the kernel
    /// turned around.
    pub fn turned(&self) -> Option<Geometry> {
        let [kh, kw] = self.kernel;
        let [top, bottom, left, right] = self.conv.pad;
        // A padding beyond the kernel's reach has no convolution back.
        let pad = [
            kh.checked_sub(1 + top)?,
            kh.checked_sub(1 + bottom)?,
            kw.checked_sub(1 + left)?,
            kw.checked_sub(1 + right)?,
        ];
        (self.conv.stride == 1).then_some(Geometry {
            channels: self.outputs,
            outputs: self.channels,
            height: self.out_height,
            width: self.out_width,
            out_height: self.height,
            out_width: self.width,
            conv: Conv { stride: 1, pad },
            ..*self
        })
    }
}
