//! Adam for a field's parameters (Kingma and Ba 2015): every step for matrices, only when touched for hash entries. Knows
//! nothing of what the gradients come from.

use crate::config::FEATURES;
use rayon::prelude::*;

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.99;
const EPSILON: f32 = 1e-15;
/// Entries one task updates; fixed only to bound the tasks, as entries do not depend on each other.
const CHUNK: usize = 8192;
/// After so many steps the bias corrections are 1 in f32.
const CORRECTED: usize = 2048;

/// First and second moments of a dense parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Running mean of the gradient.
    pub first: Vec<f32>,
    /// Running mean of its square.
    pub second: Vec<f32>,
}

impl Moments {
    /// Zero moments for `len` parameters.
    pub fn new(len: usize) -> Self {
        Self { first: vec![0.0; len], second: vec![0.0; len] }
    }
}

/// Step sizes for every count of steps an entry may have taken.
pub struct Rates(Vec<f32>);

impl Rates {
    /// `rate` with the bias corrections sqrt(1 - beta2^n) / (1 - beta1^n) for n = 1, 2, ...
    pub fn new(rate: f32) -> Self {
        let correction = |n: i32| (1.0 - f64::from(BETA2).powi(n)).sqrt() / (1.0 - f64::from(BETA1).powi(n));
        Self((1..=CORRECTED as i32).map(|n| (f64::from(rate) * correction(n)) as f32).collect())
    }

    fn at(&self, steps: u32) -> f32 {
        self.0[(steps.max(1) as usize).min(CORRECTED) - 1]
    }
}

#[inline(always)]
fn update(parameter: &mut f32, gradient: f32, first: &mut f32, second: &mut f32, rate: f32) {
    *first = BETA1 * *first + (1.0 - BETA1) * gradient;
    *second = BETA2 * *second + (1.0 - BETA2) * gradient * gradient;
    *parameter -= rate * *first / (second.sqrt() + EPSILON);
}

/// Step number `step` (from 1) of matrices, with `l2` times the parameter added to its gradient.
pub fn update_dense(
    parameters: &mut [f32],
    gradient: &[f32],
    moments: &mut Moments,
    rates: &Rates,
    step: u32,
    l2: f32,
) {
    let rate = rates.at(step);
    let moments = moments.first.iter_mut().zip(&mut moments.second);
    for ((parameter, gradient), (first, second)) in parameters.iter_mut().zip(gradient).zip(moments) {
        update(parameter, gradient + l2 * *parameter, first, second, rate);
    }
}

/// Moments of hash entries, each with a step counter of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseMoments {
    /// Running means of the gradients.
    pub first: Vec<[f32; FEATURES]>,
    /// Running means of their squares.
    pub second: Vec<[f32; FEATURES]>,
    /// Steps an entry has taken.
    pub steps: Vec<u32>,
}

impl SparseMoments {
    /// Zero moments for `len` entries.
    pub fn new(len: usize) -> Self {
        Self { first: vec![[0.0; FEATURES]; len], second: vec![[0.0; FEATURES]; len], steps: vec![0; len] }
    }
}

/// One step of the hash entries with a gradient; entries whose gradient is exactly zero rest, as in instant-ngp. Clears the
/// gradient for the next step.
pub fn update_sparse(
    table: &mut [[f32; FEATURES]],
    gradient: &mut [[f32; FEATURES]],
    moments: &mut SparseMoments,
    rates: &Rates,
) {
    let parameters = table.par_chunks_mut(CHUNK).zip(gradient.par_chunks_mut(CHUNK));
    let first = moments.first.par_chunks_mut(CHUNK).zip(moments.second.par_chunks_mut(CHUNK));
    let steps = moments.steps.par_chunks_mut(CHUNK);
    parameters.zip(first).zip(steps).for_each(|(((table, gradient), (first, second)), steps)| {
        for i in 0..table.len() {
            if gradient[i] == [0.0; FEATURES] {
                continue;
            }
            steps[i] += 1;
            let rate = rates.at(steps[i]);
            for f in 0..FEATURES {
                update(&mut table[i][f], gradient[i][f], &mut first[i][f], &mut second[i][f], rate);
            }
            gradient[i] = [0.0; FEATURES];
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_size_of_the_rate() {
        let mut parameters = [1.0, 1.0];
        update_dense(&mut parameters, &[0.3, -7.0], &mut Moments::new(2), &Rates::new(0.01), 1, 0.0);
        assert!((parameters[0] - 0.99).abs() < 1e-6 && (parameters[1] - 1.01).abs() < 1e-6);
    }

    #[test]
    fn l2_pulls_towards_zero() {
        let mut parameters = [1.0];
        update_dense(&mut parameters, &[0.0], &mut Moments::new(1), &Rates::new(0.01), 1, 1e-6);
        assert!((parameters[0] - 0.99).abs() < 1e-6);
    }

    #[test]
    fn an_entry_without_a_gradient_rests_and_keeps_its_count() {
        let mut moments = SparseMoments::new(2);
        let mut table = [[1.0, 1.0], [1.0, 1.0]];
        let rates = Rates::new(0.01);
        update_sparse(&mut table, &mut [[0.5, 0.5], [0.0, 0.0]], &mut moments, &rates);
        update_sparse(&mut table, &mut [[0.0, 0.0], [0.5, 0.0]], &mut moments, &rates);
        assert_eq!(moments.steps, [1, 1]);
        assert!((table[0][0] - 0.99).abs() < 1e-6, "one step, then rest");
        assert!((table[1][0] - 0.99).abs() < 1e-6, "its first step has the first step's correction");
        assert_eq!(table[1][1], 1.0);
    }

    #[test]
    fn the_gradient_is_cleared() {
        let mut gradient = [[0.5, 0.5]];
        update_sparse(&mut [[0.0; 2]], &mut gradient, &mut SparseMoments::new(1), &Rates::new(0.01));
        assert_eq!(gradient, [[0.0; 2]]);
    }
}
