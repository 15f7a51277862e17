//! Adam (Kingma and Ba 2015) for the numbers of one splat. Knows no gradients' origin.

/// How fast the means of gradients and of their squares forget.
const MOMENTUM: f32 = 0.9;
// The usual 0.999 takes a thousand steps to forget; a fit has a few hundred.
const SQUARES: f32 = 0.99;
/// Gradients below are as good as none. They are sums over pixels, so around 1.
const FLOOR: f32 = 1e-8;

/// The means of one number's gradient.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    mean: f32,
    square: f32,
}

/// What all numbers of a step have in common.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    mean: f32,
    square: f32,
}

impl Step {
    /// The step of this number, from 1.
    pub fn new(number: u32) -> Self {
        // Both means start at 0; divided by 1 - kept^n they are unbiased from the first step on.
        let whole = |kept: f32| 1.0 / (1.0 - kept.powi(number as i32));
        Self {
            mean: whole(MOMENTUM),
            square: whole(SQUARES),
        }
    }
}

impl Moments {
    /// By what the number changes.
    pub fn change(&mut self, gradient: f32, rate: f32, step: Step) -> f32 {
        self.mean = MOMENTUM * self.mean + (1.0 - MOMENTUM) * gradient;
        self.square = SQUARES * self.square + (1.0 - SQUARES) * gradient * gradient;
        -rate * step.mean * self.mean / ((step.square * self.square).sqrt() + FLOOR)
    }
}
