//! Six learnt parameters of every view, and the Adam optimiser that moves them while a field is
//! trained. Knows nothing of what they mean.

use crate::tensors::{FieldError, Tensors, take};

/// Parameters of a view.
pub const COUNT: usize = 6;
const BETA1: f32 = 0.9;
/// A view has few pixels in a batch, so its gradients scatter more than a field's.
const BETA2: f32 = 0.999;
const EPSILON: f32 = 1e-12;

/// The parameters of one view, or a gradient to them.
pub type ViewVector = [f32; COUNT];

/// The parameters of all views, with Adam's moments (Kingma and Ba 2015).
#[derive(Clone, Debug, PartialEq)]
pub struct ViewParameters {
    /// By view, in the trainer's order.
    pub values: Vec<ViewVector>,
    first: Vec<ViewVector>,
    second: Vec<ViewVector>,
}

impl ViewParameters {
    /// All zero, moments too.
    pub fn new(views: usize) -> Self {
        let zero = || vec![[0.0; COUNT]; views];
        Self {
            values: zero(),
            first: zero(),
            second: zero(),
        }
    }

    /// Step number `n`, from 1.
    pub fn step(&mut self, gradient: &[ViewVector], rate: f64, n: u32) {
        let n = i32::try_from(n).unwrap_or(i32::MAX);
        // In f64: 1 - 0.999^n has few digits in f32 while n is small.
        let correction = (1.0 - f64::from(BETA2).powi(n)).sqrt() / (1.0 - f64::from(BETA1).powi(n));
        let rate = (rate * correction) as f32;
        let values = self.values.as_flattened_mut().iter_mut();
        let moments = self.first.as_flattened_mut().iter_mut();
        let moments = moments.zip(self.second.as_flattened_mut());
        for ((value, d), (first, second)) in values.zip(gradient.as_flattened()).zip(moments) {
            *first = BETA1 * *first + (1.0 - BETA1) * d;
            *second = BETA2 * *second + (1.0 - BETA2) * d * d;
            *value -= rate * *first / (second.sqrt() + EPSILON);
        }
    }

    /// All of it as tensors whose names begin with `prefix`.
    pub fn tensors(&self, prefix: &str) -> Tensors {
        self.parts()
            .map(|(name, values)| {
                let flat = values.as_flattened().to_vec();
                (
                    format!("{prefix}.{name}"),
                    (vec![values.len(), COUNT], flat),
                )
            })
            .into()
    }

    /// Takes up what [`ViewParameters::tensors`] gave.
    pub fn read(&mut self, prefix: &str, tensors: &Tensors) -> Result<(), FieldError> {
        let shape = [self.values.len(), COUNT];
        let part = |name: &str| -> Result<Vec<ViewVector>, FieldError> {
            Ok(take(tensors, &format!("{prefix}.{name}"), &shape)?
                .as_chunks()
                .0
                .to_vec())
        };
        self.values = part("values")?;
        self.first = part("first")?;
        self.second = part("second")?;
        Ok(())
    }

    fn parts(&self) -> [(&'static str, &Vec<ViewVector>); 3] {
        [
            ("values", &self.values),
            ("first", &self.first),
            ("second", &self.second),
        ]
    }
}

/// Sums of gradients in the order that they come in.
pub fn sum<'a>(views: usize, parts: impl Iterator<Item = &'a Vec<ViewVector>>) -> Vec<ViewVector> {
    let mut sum = vec![[0.0; COUNT]; views];
    for part in parts {
        let of_all = sum.as_flattened_mut().iter_mut();
        of_all
            .zip(part.as_flattened())
            .for_each(|(sum, d)| *sum += d);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_size_of_the_rate_and_numbers_without_a_gradient_stay() {
        let mut parameters = ViewParameters::new(2);
        parameters.step(&[[0.3, -7.0, 0.0, 0.0, 0.0, 0.0], [0.0; 6]], 0.01, 1);
        let [a, b, ..] = parameters.values[0];
        assert!(
            (a + 0.01).abs() < 1e-6 && (b - 0.01).abs() < 1e-6,
            "{a} {b}"
        );
        assert_eq!(parameters.values[1], [0.0; 6]);
    }

    #[test]
    fn they_come_back_from_tensors_bit_by_bit() {
        let mut parameters = ViewParameters::new(2);
        parameters.step(&[[0.1; 6], [-0.2; 6]], 0.01, 1);
        let mut back = ViewParameters::new(2);
        back.read("x", &parameters.tensors("x")).unwrap();
        assert_eq!(back, parameters);
        assert!(
            ViewParameters::new(3)
                .read("x", &parameters.tensors("x"))
                .is_err()
        );
    }
}
