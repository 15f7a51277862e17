//! Adam for a field's parameters (Kingma and Ba 2015): every step for matrices, only when touched for hash entries. Knows
//! nothing of what the gradients come from.

use crate::config::FEATURES;
use crate::kernels::hash::Entry;
use half::slice::HalfFloatSliceExt;
use pulp::{Arch, Simd, WithSimd};

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.99;
const EPSILON: f32 = 1e-15;
/// Entries looked at together: all of them rest or all are worked out, and those that rest keep what they had.
const GROUP: usize = 16;
/// After so many steps the bias corrections are 1 in f32.
pub const CORRECTED: usize = 2048;

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

/// The bias corrections of step `n`: sqrt(1 - beta2^n) / (1 - beta1^n).
pub fn correction(n: i32) -> f64 {
    (1.0 - f64::from(BETA2).powi(n)).sqrt() / (1.0 - f64::from(BETA1).powi(n))
}

impl Rates {
    /// `rate` with the bias corrections sqrt(1 - beta2^n) / (1 - beta1^n) for n = 1, 2, ...
    pub fn new(rate: f32) -> Self {
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

/// The hash table's single-precision values with their moments, each entry with a step counter of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseMoments {
    /// The values that steps are taken on; look-ups read them rounded to halves.
    pub values: Vec<[f32; FEATURES]>,
    /// Running means of the gradients.
    pub first: Vec<[f32; FEATURES]>,
    /// Running means of their squares.
    pub second: Vec<[f32; FEATURES]>,
    /// Steps an entry has taken; it stops at [`CORRECTED`].
    pub steps: Vec<u16>,
}

impl SparseMoments {
    /// The values of a table, and zero moments.
    pub fn new(table: &[Entry]) -> Self {
        let zeros = || vec![[0.0; FEATURES]; table.len()];
        let values = table.iter().map(|entry| entry.map(f32::from)).collect();
        Self { values, first: zeros(), second: zeros(), steps: vec![0; table.len()] }
    }

    /// Everything, in parts of the given lengths.
    pub fn split(&mut self, lengths: impl Iterator<Item = usize>) -> Vec<SparsePart<'_>> {
        let (mut values, mut first, mut second) = (&mut self.values[..], &mut self.first[..], &mut self.second[..]);
        let mut steps = &mut self.steps[..];
        let part = |length| SparsePart {
            values: values.split_off_mut(..length).unwrap_or_default(),
            first: first.split_off_mut(..length).unwrap_or_default(),
            second: second.split_off_mut(..length).unwrap_or_default(),
            steps: steps.split_off_mut(..length).unwrap_or_default(),
        };
        lengths.map(part).collect()
    }
}

/// The entries of one level in [`SparseMoments`].
pub struct SparsePart<'a> {
    values: &'a mut [[f32; FEATURES]],
    first: &'a mut [[f32; FEATURES]],
    second: &'a mut [[f32; FEATURES]],
    steps: &'a mut [u16],
}

/// One step of the hash entries with a gradient; entries whose gradient is exactly zero rest, as in instant-ngp. Writes the
/// table that look-ups read, and clears the gradient for the next step.
pub fn update_sparse(table: &mut [Entry], gradient: &mut [[f32; FEATURES]], part: SparsePart<'_>, rates: &Rates) {
    assert!(table.len() == gradient.len() && table.len() == part.values.len(), "update_sparse: sizes differ");
    Arch::new().dispatch(UpdateSparse { table, gradient, part, rates });
}

struct UpdateSparse<'a> {
    table: &'a mut [Entry],
    gradient: &'a mut [[f32; FEATURES]],
    part: SparsePart<'a>,
    rates: &'a Rates,
}

impl WithSimd for UpdateSparse<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let SparsePart { values, first, second, steps } = self.part;
        let state = (values.chunks_mut(GROUP).zip(first.chunks_mut(GROUP)))
            .zip(second.chunks_mut(GROUP).zip(steps.chunks_mut(GROUP)));
        let tables = self.table.chunks_mut(GROUP).zip(self.gradient.chunks_mut(GROUP));
        for ((table, gradient), ((values, first), (second, steps))) in tables.zip(state) {
            let gradient = gradient.as_flattened_mut();
            if gradient.iter().all(|&g| g == 0.0) {
                continue;
            }
            let mut rate = [[0f32; FEATURES]; GROUP];
            for ((rate, gradient), steps) in rate.iter_mut().zip(gradient.as_chunks::<FEATURES>().0).zip(steps) {
                if *gradient != [0.0; FEATURES] {
                    *steps = (*steps + 1).min(CORRECTED as u16);
                    *rate = [self.rates.at(u32::from(*steps)); FEATURES];
                }
            }
            let values = values.as_flattened_mut();
            let state = values.iter_mut().zip(first.as_flattened_mut()).zip(second.as_flattened_mut());
            for (((value, first), second), (&g, &rate)) in state.zip(gradient.iter().zip(rate.as_flattened())) {
                let (mut v, mut m, mut s) = (*value, *first, *second);
                update(&mut v, g, &mut m, &mut s, rate);
                // An entry that rests has rate 0.
                (*value, *first, *second) = if rate > 0.0 { (v, m, s) } else { (*value, *first, *second) };
            }
            table.as_flattened_mut().convert_from_f32_slice(values);
            gradient.fill(0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use half::f16;

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

    fn step(table: &mut [Entry], gradient: &mut [[f32; 2]], moments: &mut SparseMoments) {
        let part = moments.split(std::iter::once(table.len())).pop().unwrap();
        update_sparse(table, gradient, part, &Rates::new(0.01));
    }

    #[test]
    fn an_entry_without_a_gradient_rests_and_keeps_its_count() {
        let mut table = [[f16::ONE; 2]; 2];
        let mut moments = SparseMoments::new(&table);
        step(&mut table, &mut [[0.5, 0.5], [0.0, 0.0]], &mut moments);
        step(&mut table, &mut [[0.0, 0.0], [0.5, 0.0]], &mut moments);
        assert_eq!(moments.steps, [1, 1]);
        assert!((moments.values[0][0] - 0.99).abs() < 1e-6, "one step, then rest");
        assert!((moments.values[1][0] - 0.99).abs() < 1e-6, "its first step has the first step's correction");
        assert_eq!(moments.values[1][1], 1.0);
        assert_eq!(table[0], moments.values[0].map(f16::from_f32));
    }

    #[test]
    fn the_gradient_is_cleared() {
        let (mut table, mut gradient) = ([[f16::ONE; 2]; 40], [[0.5, 0.5]; 40]);
        let mut moments = SparseMoments::new(&table);
        step(&mut table, &mut gradient, &mut moments);
        assert_eq!(gradient, [[0.0; 2]; 40]);
        assert!(moments.values.iter().all(|entry| *entry == moments.values[0]), "a part of a group is no exception");
    }
}
