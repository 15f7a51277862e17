//! The residual latent of one view, and the optimiser that changes a window of it. Knows no
//! guidance rule.
//!
//! The optimiser is sparse: moments and step counts belong to pixels, and a pixel outside the
//! window is left alone. (The dense Adam of DiSR-NeRF keeps moving a pixel long after a crop last
//! saw it.)

use super::options::Optimizer;
use super::window::Window;

/// What is learnt for one view: `values` is h of z' = z + h, `[channels, height, width]`, with the
/// optimiser's state.
#[derive(Clone, Debug, PartialEq)]
pub struct Residual {
    /// Channels, height and width in latent pixels.
    pub shape: [usize; 3],
    /// The residual latent, zero at first.
    pub values: Vec<f32>,
    /// Decayed mean of the gradient, by element; empty for plain gradient descent.
    pub mean: Vec<f32>,
    /// Decayed mean of the squared gradient, by element; empty for plain gradient descent.
    pub square: Vec<f32>,
    /// How often a window has covered the pixel, `[height, width]`.
    pub visits: Vec<u32>,
}

impl Residual {
    /// The residual before the first step.
    pub fn zero(shape: [usize; 3], optimizer: &Optimizer) -> Self {
        let len: usize = shape.iter().product();
        let moments = if matches!(optimizer, Optimizer::Adam(_)) {
            len
        } else {
            0
        };
        Self {
            shape,
            values: vec![0.0; len],
            mean: vec![0.0; moments],
            square: vec![0.0; moments],
            visits: vec![0; shape[1] * shape[2]],
        }
    }

    /// The part of the residual in a window, `[channels, window.height, window.width]`.
    pub fn crop(&self, window: &Window) -> Vec<f32> {
        self.rows(window)
            .flat_map(|(row, _)| &self.values[row..row + window.width])
            .copied()
            .collect()
    }

    /// One step down `gradient`, `[channels, window.height, window.width]`, for the pixels of the
    /// window alone.
    pub fn descend(&mut self, window: &Window, gradient: &[f32], rate: f64, optimizer: &Optimizer) {
        let [_, _, width] = self.shape;
        for row in window.top..window.top + window.height {
            // Bias correction counts a pixel's own visits: at a pixel's first visit its moments are
            // as young as at step 1.
            let start = row * width + window.left;
            self.visits[start..start + window.width]
                .iter_mut()
                .for_each(|visits| *visits += 1);
        }
        let rows: Vec<_> = self.rows(window).collect();
        for ((element, pixel), gradient) in rows.into_iter().zip(gradient.chunks(window.width)) {
            for (x, &gradient) in gradient.iter().enumerate() {
                let step = self.step(
                    element + x,
                    self.visits[pixel + x],
                    gradient.into(),
                    optimizer,
                );
                // Rounded once, here: the step itself is computed in f64.
                self.values[element + x] -= (rate * step) as f32;
            }
        }
    }

    /// The step for one element at rate 1. Kingma and Ba 2014, algorithm 1.
    fn step(&mut self, element: usize, visits: u32, gradient: f64, optimizer: &Optimizer) -> f64 {
        // Plain descent keeps the direction's size, which Adam divides away.
        let Optimizer::Adam(moments) = optimizer else {
            return gradient;
        };
        let decayed = |old: f32, beta: f64, new: f64| beta * f64::from(old) + (1.0 - beta) * new;
        // `descend` has counted this visit and beta is below 1, so nothing is divided by 0.
        let unbiased = |moment: f64, beta: f64| moment / (1.0 - beta.powi(visits as i32));
        let mean = decayed(self.mean[element], moments.beta1, gradient);
        let square = decayed(self.square[element], moments.beta2, gradient * gradient);
        (self.mean[element], self.square[element]) = (mean as f32, square as f32);
        // eps stands outside the root, as in the paper. Being as large as the directions
        // themselves, it damps the small ones.
        unbiased(mean, moments.beta1) / (unbiased(square, moments.beta2).sqrt() + moments.eps)
    }

    /// Where the window's rows start, channel by channel: the index of the element and of the
    /// pixel.
    fn rows(&self, window: &Window) -> impl Iterator<Item = (usize, usize)> + use<> {
        let [channels, height, width] = self.shape;
        let Window {
            top,
            left,
            height: rows,
            ..
        } = *window;
        let pixels = move |row| row * width + left;
        (0..channels).flat_map(move |c| {
            (top..top + rows).map(move |y| (c * height * width + pixels(y), pixels(y)))
        })
    }
}
