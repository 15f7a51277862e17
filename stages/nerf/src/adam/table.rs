//! Adam for the hash table: an entry takes a step only when it has a gradient, and counts its own
//! steps. Knows nothing of what the gradients come from.
//!
//! A step is bound by memory, so that moments have 16 bits each ([`super::packed`]).

use super::packed::{FIRST, SECOND, pack, pack_halves, unpack};
use super::{CORRECTED, CORRECTIONS, advance};
use crate::config::FEATURES;
use crate::kernels::hash::Entry;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Entries that go through all that a step takes together; they stay in the first-level cache.
const CHUNK: usize = 128;
/// Entries that a thread takes at once.
const PIECE: usize = 1 << 14;

/// The hash table's single-precision values with their moments, each entry with a step counter of
/// its own.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseMoments {
    /// The values that steps are taken on; look-ups read them rounded to halves.
    pub values: Vec<[f32; FEATURES]>,
    /// Running means of the gradients, packed.
    pub first: Vec<[u16; FEATURES]>,
    /// Running means of their squares, packed.
    pub second: Vec<[u16; FEATURES]>,
    /// Steps an entry has taken; it stops at [`CORRECTED`].
    pub steps: Vec<u16>,
}

impl SparseMoments {
    /// The values of a table, and zero moments.
    pub fn new(table: &[Entry]) -> Self {
        let zeros = || vec![[0; FEATURES]; table.len()];
        let values = table.iter().map(|entry| entry.map(f32::from)).collect();
        Self {
            values,
            first: zeros(),
            second: zeros(),
            steps: vec![0; table.len()],
        }
    }

    /// First and second moments as numbers.
    pub fn unpacked(&self) -> [Vec<f32>; 2] {
        let mut first = vec![0.0; FEATURES * self.first.len()];
        let mut second = vec![0.0; FEATURES * self.second.len()];
        unpack::<FIRST>(self.first.as_flattened(), &mut first);
        unpack::<SECOND>(self.second.as_flattened(), &mut second);
        [first, second]
    }

    /// Takes first and second moments from numbers, as many as there are.
    pub fn pack(&mut self, [first, second]: [&[f32]; 2]) {
        pack::<FIRST>(first, self.first.as_flattened_mut());
        pack::<SECOND>(second, self.second.as_flattened_mut());
    }

    /// Everything, in parts of the given lengths.
    pub fn split(&mut self, lengths: impl Iterator<Item = usize>) -> Vec<SparsePart<'_>> {
        let mut values = &mut self.values[..];
        let mut first = &mut self.first[..];
        let mut second = &mut self.second[..];
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

/// Some of the entries in [`SparseMoments`], such as those of one level.
pub struct SparsePart<'a> {
    values: &'a mut [[f32; FEATURES]],
    first: &'a mut [[u16; FEATURES]],
    second: &'a mut [[u16; FEATURES]],
    steps: &'a mut [u16],
}

/// One step of the hash entries with a gradient; entries whose gradient is exactly zero rest, as in
/// instant-ngp. Writes the table that look-ups read, and clears the gradient for the next step.
/// Entries come in groups of eight, as those of levels do. Threads without work take pieces of it.
pub fn update_sparse(
    table: &mut [Entry],
    gradient: &mut [[f32; FEATURES]],
    part: SparsePart<'_>,
    rate: f32,
) {
    assert!(
        table.len() == gradient.len() && table.len() == part.values.len(),
        "update_sparse: sizes differ"
    );
    assert!(
        // Eight entries of two features are the 16 lanes of the widest vector.
        table.len().is_multiple_of(8),
        "update_sparse: a group is not whole"
    );
    let tables = table
        .par_chunks_mut(PIECE)
        .zip(gradient.par_chunks_mut(PIECE));
    part.par_chunks(PIECE)
        .zip(tables)
        .for_each(|(part, (table, gradient))| {
            Arch::new().dispatch(UpdateSparse {
                table,
                gradient,
                part,
                rate,
            });
        });
}

struct UpdateSparse<'a> {
    table: &'a mut [Entry],
    gradient: &'a mut [[f32; FEATURES]],
    part: SparsePart<'a>,
    rate: f32,
}

impl WithSimd for UpdateSparse<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let SparsePart {
            values,
            first,
            second,
            steps,
        } = self.part;
        let state = (values.chunks_mut(CHUNK).zip(first.chunks_mut(CHUNK)))
            .zip(second.chunks_mut(CHUNK).zip(steps.chunks_mut(CHUNK)))
            .map(|((values, first), (second, steps))| SparsePart {
                values,
                first,
                second,
                steps,
            });
        let tables = self
            .table
            .chunks_mut(CHUNK)
            .zip(self.gradient.chunks_mut(CHUNK));
        for (mut part, (table, gradient)) in state.zip(tables) {
            // First of all, since it reads which gradients there are, and `descend` clears them.
            let rates = rates(gradient, part.steps, self.rate);
            part.descend(simd, gradient, &rates);
            pack_halves(part.values.as_flattened(), table.as_flattened_mut());
        }
    }
}

/// Counts the steps of some entries, and says how large a step of theirs is: 0 for one that rests.
#[inline(always)]
fn rates(gradient: &[[f32; FEATURES]], steps: &mut [u16], rate: f32) -> [[f32; FEATURES]; CHUNK] {
    let corrections = &*CORRECTIONS;
    let mut rates = [[0.0; FEATURES]; CHUNK];
    // Both bits are shifted out of their signs, since -0 is no gradient either.
    let moves = |[a, b]: &[f32; FEATURES]| u16::from((a.to_bits() | b.to_bits()) << 1 != 0);
    for (steps, gradient) in steps.iter_mut().zip(gradient) {
        // It stops where corrections end, so that 16 bits are enough for any number of steps.
        *steps = (*steps + moves(gradient)).min(CORRECTED as u16);
    }
    for ((rates, steps), gradient) in rates.iter_mut().zip(steps).zip(gradient) {
        *rates = [f32::from(moves(gradient))
            * rate
            * corrections[usize::from(*steps).min(CORRECTED)]; FEATURES];
    }
    rates
}

impl<'a> SparsePart<'a> {
    /// Parts of so many entries.
    fn par_chunks(self, entries: usize) -> impl IndexedParallelIterator<Item = SparsePart<'a>> {
        let values = self
            .values
            .par_chunks_mut(entries)
            .zip(self.first.par_chunks_mut(entries));
        let counted = self
            .second
            .par_chunks_mut(entries)
            .zip(self.steps.par_chunks_mut(entries));
        values
            .zip(counted)
            .map(|((values, first), (second, steps))| SparsePart {
                values,
                first,
                second,
                steps,
            })
    }

    /// Takes the step, and clears the gradient.
    #[inline(always)]
    fn descend<S: Simd>(
        &mut self,
        simd: S,
        gradient: &mut [[f32; FEATURES]],
        rates: &[[f32; FEATURES]; CHUNK],
    ) {
        let mut first = [0.0; FEATURES * CHUNK];
        let mut second = [0.0; FEATURES * CHUNK];
        unpack::<FIRST>(self.first.as_flattened(), &mut first);
        unpack::<SECOND>(self.second.as_flattened(), &mut second);
        let zero = simd.splat_f32s(0.0);
        let moments = S::as_mut_simd_f32s(&mut first)
            .0
            .iter_mut()
            .zip(S::as_mut_simd_f32s(&mut second).0);
        let values = S::as_mut_simd_f32s(self.values.as_flattened_mut())
            .0
            .iter_mut();
        let gradients = S::as_mut_simd_f32s(gradient.as_flattened_mut())
            .0
            .iter_mut();
        let rates = S::as_simd_f32s(rates.as_flattened()).0;
        for ((gradient, rate), (value, (first, second))) in
            gradients.zip(rates).zip(values.zip(moments))
        {
            let rests = simd.equal_f32s(*rate, zero);
            // Most vectors of a large table have no gradient in a step, and are left as they are.
            if simd.first_true_m32s(simd.not_m32s(rests)) == S::F32_LANES {
                continue;
            }
            let stay = [*value, *first, *second];
            let go = advance(simd, stay, *gradient, *rate);
            [*value, *first, *second] =
                // Both ways are computed and one is taken, lane by lane.
                std::array::from_fn(|i| simd.select_f32s(rests, stay[i], go[i]));
            // Cleared while it is in the cache: nobody else passes over the gradient.
            *gradient = zero;
        }
        pack::<FIRST>(&first, self.first.as_flattened_mut());
        pack::<SECOND>(&second, self.second.as_flattened_mut());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use half::f16;

    fn step(table: &mut [Entry], gradient: &mut [[f32; 2]], moments: &mut SparseMoments) {
        let part = moments.split(std::iter::once(table.len())).pop().unwrap();
        update_sparse(table, gradient, part, 0.01);
    }

    #[test]
    fn an_entry_without_a_gradient_rests_and_keeps_its_count() {
        let mut table = [[f16::ONE; 2]; 8];
        let mut moments = SparseMoments::new(&table);
        let only = |entry: usize, d: [f32; 2]| {
            std::array::from_fn::<_, 8, _>(|i| if i == entry { d } else { [0.0; 2] })
        };
        step(&mut table, &mut only(0, [0.5, 0.5]), &mut moments);
        step(&mut table, &mut only(1, [0.5, 0.0]), &mut moments);
        assert_eq!(moments.steps[..3], [1, 1, 0]);
        assert!(
            (moments.values[0][0] - 0.99).abs() < 1e-6,
            "one step, then rest"
        );
        assert!(
            (moments.values[1][0] - 0.99).abs() < 1e-6,
            "its first step has the first step's correction"
        );
        assert_eq!((moments.values[1][1], moments.values[2]), (1.0, [1.0; 2]));
        assert_eq!(table[0], moments.values[0].map(f16::from_f32));
    }

    #[test]
    fn the_gradient_is_cleared() {
        let mut table = [[f16::ONE; 2]; 3 * CHUNK / 2];
        let mut gradient = [[0.5, 0.5]; 3 * CHUNK / 2];
        let mut moments = SparseMoments::new(&table);
        step(&mut table, &mut gradient, &mut moments);
        assert!(gradient.iter().all(|d| *d == [0.0; 2]));
        assert!(
            moments
                .values
                .iter()
                .all(|entry| *entry == moments.values[0]),
            "a part of a chunk is no exception"
        );
    }

    #[cfg(target_arch = "x86_64")]
    /// Values, moments and table after two steps with the vectors of one instruction set.
    fn two_steps<S: Simd>(simd: S) -> (Vec<Entry>, SparseMoments) {
        let rng = compute::rng::Rng::new(1, "adam test");
        let mut table: Vec<Entry> = (0..264)
            .map(|i| [0, 1].map(|f| f16::from_f32(rng.normal(f, i))))
            .collect();
        let mut moments = SparseMoments::new(&table);
        for round in 0..2 {
            let d = |i: u64| {
                [2, 3].map(|f| {
                    rng.normal(2 * round + f, i) * f32::from(rng.uniform(9 + round, i) < 0.6)
                })
            };
            let mut gradient: Vec<_> = (0..264).map(d).collect();
            let part = moments.split(std::iter::once(264)).pop().unwrap();
            simd.vectorize(UpdateSparse {
                table: &mut table,
                gradient: &mut gradient,
                part,
                rate: 0.01,
            });
        }
        (table, moments)
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn every_vector_width_gives_the_same_bits() {
        let portable = two_steps(pulp::Scalar);
        assert!(pulp::x86::V3::try_new().is_none_or(|simd| two_steps(simd) == portable));
        assert!(pulp::x86::V4::try_new().is_none_or(|simd| two_steps(simd) == portable));
    }
}
