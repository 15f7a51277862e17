//! Filters, and the windows of weights that they give along one axis. They know no image.

use std::f64::consts::PI;

/// The interpolation kernel, named after the library whose numbers it reproduces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// The pixel under the scaled corner, as PyTorch's `nearest`.
    Nearest,
    /// The triangle.
    Bilinear,
    /// Keys' cubic (1981) with a = -0.75, edges repeated: PyTorch's `bicubic`. Antialiased, PyTorch
    /// takes a = -0.5.
    BicubicTorch,
    /// Keys' cubic with a = -0.5, windows cut and renormalised at the edges: Pillow's `BICUBIC`.
    BicubicPil,
    /// The sinc windowed by a sinc, three lobes: Pillow's `LANCZOS`.
    Lanczos3,
    /// The mean of the pixels touched, as PyTorch's `area`.
    Area,
}

/// For each output index, the window of input indices it sums and their weights.
#[derive(Clone, Debug)]
pub struct Taps {
    pub windows: Vec<Window>,
}

#[derive(Clone, Debug)]
pub struct Window {
    pub first: usize,
    pub weights: Vec<f32>,
}

/// Keys' cubic convolution kernel, which reaches two pixels.
fn cubic(x: f64, a: f64) -> f64 {
    match x.abs() {
        x if x < 1.0 => ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0,
        x if x < 2.0 => (((x - 5.0) * x + 8.0) * x - 4.0) * a,
        _ => 0.0,
    }
}

fn triangle(x: f64) -> f64 {
    (1.0 - x.abs()).max(0.0)
}

fn lanczos3(x: f64) -> f64 {
    let sinc = |x: f64| {
        if x == 0.0 {
            1.0
        } else {
            (PI * x).sin() / (PI * x)
        }
    };
    if x.abs() < 3.0 {
        sinc(x) * sinc(x / 3.0)
    } else {
        0.0
    }
}

impl Filter {
    /// The windows that make `to` outputs of `from` inputs.
    pub fn taps(self, from: usize, to: usize, antialias: bool) -> Taps {
        let scale = from as f64 / to as f64;
        // Only where the image shrinks: enlarged, an antialiased filter is the plain one.
        let stretch = if antialias { scale.max(1.0) } else { 1.0 };
        let window = |i: usize| match self {
            Filter::Nearest => Window {
                // In whole numbers, where a product of floats could fall just below a pixel.
                first: i * from / to,
                weights: vec![1.0],
            },
            Filter::Area => area(i, from, to),
            Filter::Bilinear if !antialias => repeated(i, scale, from, 1, triangle),
            Filter::BicubicTorch if !antialias => repeated(i, scale, from, 2, |x| cubic(x, -0.75)),
            Filter::Bilinear => renormalised(i, scale, from, 1.0, stretch, triangle),
            Filter::BicubicTorch | Filter::BicubicPil => {
                renormalised(i, scale, from, 2.0, stretch, |x| cubic(x, -0.5))
            }
            Filter::Lanczos3 => renormalised(i, scale, from, 3.0, stretch, lanczos3),
        };
        Taps {
            windows: (0..to).map(window).collect(),
        }
    }
}

/// Every pixel that the output pixel touches, with equal weights.
fn area(i: usize, from: usize, to: usize) -> Window {
    let first = i * from / to;
    // A pixel that is touched in part counts in full, as PyTorch has it.
    let end = ((i + 1) * from).div_ceil(to);
    Window {
        first,
        weights: vec![1.0 / (end - first) as f32; end - first],
    }
}

/// A window of `2 * reach` pixels around the centre, where pixels beyond the edge repeat the edge.
fn repeated(
    i: usize,
    scale: f64,
    from: usize,
    reach: isize,
    kernel: impl Fn(f64) -> f64,
) -> Window {
    // Centres lie at half-integers in both images; indices count from the first centre.
    let centre = (i as f64 + 0.5) * scale - 0.5;
    let base = centre.floor() as isize - reach + 1;
    let clamped = |k: isize| (base + k).clamp(0, from as isize - 1) as usize;
    let first = clamped(0);
    let mut weights = vec![0.0; clamped(2 * reach - 1) - first + 1];
    for k in 0..2 * reach {
        weights[clamped(k) - first] += kernel((base + k) as f64 - centre) as f32;
    }
    Window { first, weights }
}

/// The pixels within `reach * stretch` of the centre that exist, with weights that sum to 1.
fn renormalised(
    i: usize,
    scale: f64,
    from: usize,
    reach: f64,
    stretch: f64,
    kernel: impl Fn(f64) -> f64,
) -> Window {
    let centre = (i as f64 + 0.5) * scale;
    // Truncated after adding a half, as Pillow does: other roundings add or lose a pixel at the
    // rim.
    let first = (centre - reach * stretch + 0.5).max(0.0) as usize;
    let end = ((centre + reach * stretch + 0.5) as usize).min(from);
    let raw: Vec<f64> = (first..end)
        .map(|k| kernel((k as f64 + 0.5 - centre) / stretch))
        .collect();
    // In f64, and rounded once: weights of a wide window must still sum to 1.
    let total: f64 = raw.iter().sum();
    Window {
        first,
        weights: raw.iter().map(|weight| (weight / total) as f32).collect(),
    }
}

impl Taps {
    /// The taps of the adjoint map, back to `from` inputs. Windows advance monotonically, so the
    /// outputs that see one input are contiguous too.
    pub fn transposed(&self, from: usize) -> Taps {
        let mut windows = vec![
            Window {
                first: 0,
                weights: Vec::new()
            };
            from
        ];
        for (i, window) in self.windows.iter().enumerate() {
            for (k, &weight) in window.weights.iter().enumerate() {
                let target = &mut windows[window.first + k];
                if target.weights.is_empty() {
                    target.first = i;
                }
                // An output that skips this input leaves a zero.
                target.weights.resize(i - target.first, 0.0);
                target.weights.push(weight);
            }
        }
        Taps { windows }
    }
}
