//! How each photo was exposed: a gain and an offset per channel, learnt with the field. Knows
//! nothing of rays.
//!
//! Photos are compared in sRGB-encoded values. Above its straight foot the encoding is
//! 1.055 x^(1/2.4) - 0.055, so a gain in linear light is exactly an affine map there, about the
//! point -0.055. That is the map that is learnt, with an offset for what no gain explains.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::exponential::exp;
use crate::tensors::{FieldError, Tensors};
use crate::view_parameters::{self, ViewParameters, ViewVector};

/// The encoded value, turned over, that a gain in linear light leaves where it is.
const PIVOT: f32 = 0.055;
/// The exponent of the sRGB encoding above its straight foot, turned over.
const GAMMA: f32 = 2.4;
/// From here on a value counts as cut off at white: encoding linear 1 gives a little less than 1, and
/// the next value of an 8-bit photo is 0.996.
pub const WHITE: f32 = 0.999;
/// The name of the numbers among a trainer's tensors.
const NAME: &str = "trainer.exposure";

/// How exposures are learnt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ExposureOptions {
    /// Adam's rate at its highest: it rises and falls as the field's does.
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub rate: f64,
    /// What a departure from the identity costs: half its square, times this, beside half the
    /// squared error of a photo's colours.
    #[schemars(range(min = 0, max = 1000))]
    pub pull: f64,
}

/// At 0.005 a stop takes some 60 steps. The pull is a hundredth of what a photo of middle grey says
/// about its own gain.
impl Default for ExposureOptions {
    fn default() -> Self {
        Self {
            rate: 5e-3,
            pull: 1e-3,
        }
    }
}

/// What one photo shows of a colour c, sRGB-encoded, by channel: `gain * c + lift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Factors, above 0; 1 changes nothing.
    pub gain: [f32; 3],
    /// Offsets in encoded values; 0 changes nothing.
    pub lift: [f32; 3],
    /// The factors that these are in linear light.
    pub linear_gain: [f32; 3],
}

impl Exposure {
    /// A photo that shows colours as they are.
    pub const NONE: Self = Self {
        gain: [1.0; 3],
        lift: [0.0; 3],
        linear_gain: [1.0; 3],
    };

    /// Of a view's six numbers: the logarithms of three gains, and three offsets.
    fn of(vector: &ViewVector) -> Self {
        let gain = [0, 1, 2].map(|c| exp(vector[c]));
        let lift = [0, 1, 2].map(|c| PIVOT * (gain[c] - 1.0) + vector[3 + c]);
        Self {
            gain,
            lift,
            linear_gain: [0, 1, 2].map(|c| exp(GAMMA * vector[c])),
        }
    }

    /// The gradient to the six numbers from those to gain and lift.
    pub fn backward(&self, d_gain: [f32; 3], d_lift: [f32; 3]) -> ViewVector {
        // The logarithm of a gain moves the gain by itself, and the lift by PIVOT times that.
        let [a, b, c] = [0, 1, 2].map(|c| self.gain[c] * (d_gain[c] + PIVOT * d_lift[c]));
        let [d, e, f] = d_lift;
        [a, b, c, d, e, f]
    }

    /// The offsets in encoded values that gains in linear light do not explain.
    pub fn offset(&self) -> [f32; 3] {
        [0, 1, 2].map(|c| self.lift[c] - PIVOT * (self.gain[c] - 1.0))
    }

    /// The colour of which a photo shows this: the inverse of the affine map.
    pub fn inverse(&self, shown: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|c| (shown[c] - self.lift[c]) / self.gain[c])
    }
}

/// A residual, what a photo would show less what it does show, or 0 where the photo clipped the
/// value and the residual is on the clipped side: there the photo says nothing more.
pub fn clipped_residual(residual: f32, shown: f32) -> f32 {
    // A residual towards more of what was cut off is no error.
    let is_silent = shown >= WHITE && residual > 0.0 || shown <= 0.0 && residual < 0.0;
    if is_silent { 0.0 } else { residual }
}

/// The exposures of all views in training.
#[derive(Clone, Debug)]
pub struct Exposures {
    options: ExposureOptions,
    parameters: ViewParameters,
}

impl Exposures {
    /// All as they should be.
    pub fn new(options: &ExposureOptions, views: usize) -> Self {
        Self {
            options: options.clone(),
            parameters: ViewParameters::new(views),
        }
    }

    /// That of a view.
    pub fn of(&self, view: usize) -> Exposure {
        Exposure::of(&self.parameters.values[view])
    }

    /// Those of all views, in their order.
    pub fn all(&self) -> Vec<Exposure> {
        self.parameters.values.iter().map(Exposure::of).collect()
    }

    /// Step number `n`, from 1; `share` is the part of the highest rate that holds now. The mean of
    /// the six numbers over all views stays zero: the field is as bright as the photos are on
    /// average.
    pub fn descend<'a>(
        &mut self,
        parts: impl Iterator<Item = &'a Vec<ViewVector>>,
        share: f64,
        n: u32,
    ) {
        let views = self.parameters.values.len();
        let mut gradient = view_parameters::sum(views, parts);
        // The loss is a mean over views and channels, and the pull is in its terms.
        let pull = self.options.pull as f32 / (3.0 * views as f32);
        let values = self.parameters.values.as_flattened().iter();
        let pulled = gradient.as_flattened_mut().iter_mut().zip(values);
        pulled.for_each(|(d, value)| *d += pull * value);
        self.parameters
            .step(&gradient, share * self.options.rate, n);
        // After Adam, whose steps differ by view and so move the mean.
        self.center();
    }

    fn center(&mut self) {
        let values = &mut self.parameters.values;
        for i in 0..view_parameters::COUNT {
            let mean = values.iter().map(|vector| vector[i]).sum::<f32>() / values.len() as f32;
            values.iter_mut().for_each(|vector| vector[i] -= mean);
        }
    }

    /// All parameters and their moments.
    pub fn tensors(&self) -> Tensors {
        self.parameters.tensors(NAME)
    }

    /// Takes up what [`Exposures::tensors`] gave.
    pub fn read(&mut self, tensors: &Tensors) -> Result<(), FieldError> {
        self.parameters.read(NAME, tensors)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use formats::color::{linear_to_srgb, srgb_to_linear};

    const VECTOR: ViewVector = [0.2, -0.1, 0.3, 0.01, -0.02, 0.03];

    #[test]
    fn a_gain_in_linear_light_is_exact_above_the_foot() {
        let exposure = Exposure::of(&[0.25, 0.25, 0.25, 0.0, 0.0, 0.0]);
        for shown in [0.1, 0.3, 0.6] {
            let linear = srgb_to_linear(shown) * exposure.linear_gain[0];
            let expected = linear_to_srgb(linear);
            let got = exposure.gain[0] * shown + exposure.lift[0];
            assert!((got - expected).abs() < 1e-5, "{got} {expected}");
        }
    }

    #[test]
    fn undoing_an_exposure_gives_the_colour_back() {
        let exposure = Exposure::of(&VECTOR);
        let shown = [0, 1, 2].map(|c| exposure.gain[c] * 0.4 + exposure.lift[c]);
        let back = exposure.inverse(shown);
        assert!(back.iter().all(|c| (c - 0.4).abs() < 1e-6), "{back:?}");
        let offset = exposure.offset();
        assert!((0..3).all(|c| (offset[c] - VECTOR[3 + c]).abs() < 1e-6));
    }

    #[test]
    fn the_gradient_to_the_six_numbers_matches_finite_differences() {
        let color = [0.3, 0.5, 0.7];
        let d = [0.9, -0.4, 0.6];
        let value = |vector: &ViewVector| -> f32 {
            let exposure = Exposure::of(vector);
            (0..3)
                .map(|c| d[c] * (exposure.gain[c] * color[c] + exposure.lift[c]))
                .sum()
        };
        let d_gain = [0, 1, 2].map(|c| d[c] * color[c]);
        let analytic = Exposure::of(&VECTOR).backward(d_gain, d);
        for i in 0..6 {
            let at = |step: f32| {
                let mut vector = VECTOR;
                vector[i] += step;
                value(&vector)
            };
            let numeric = (at(1e-2) - at(-1e-2)) / 2e-2;
            assert!((numeric - analytic[i]).abs() < 1e-3, "{i}: {numeric}");
        }
    }

    #[test]
    fn what_is_cut_off_says_only_that_it_is_so_bright() {
        assert_eq!(
            [clipped_residual(0.2, 1.0), clipped_residual(-0.2, 1.0)],
            [0.0, -0.2]
        );
        assert_eq!(clipped_residual(0.2, linear_to_srgb(1.0)), 0.0);
        assert_eq!(clipped_residual(0.2, 254.0 / 255.0), 0.2);
        assert_eq!(
            [clipped_residual(0.2, 0.0), clipped_residual(-0.2, 0.0)],
            [0.2, 0.0]
        );
        assert_eq!(clipped_residual(0.2, 0.5), 0.2);
    }

    #[test]
    fn the_mean_over_views_stays_as_it_is() {
        let mut exposures = Exposures::new(&ExposureOptions::default(), 3);
        let gradient = vec![[1.0; 6], [-1.0; 6], [1.0; 6]];
        exposures.descend([&gradient].into_iter(), 1.0, 1);
        let sum: f32 = exposures
            .parameters
            .values
            .iter()
            .map(|vector| vector[0])
            .sum();
        assert!(sum.abs() < 1e-6 && exposures.parameters.values[1][0] > 0.0);
    }
}
