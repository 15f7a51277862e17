//! A radiance field: its space, hash table, networks and occupancy. Knows nothing of cameras,
//! training or files.

use crate::config::{FEATURES, FieldConfig, Level};
use crate::features::{Features, LookUp};
use crate::kernels::hash::Entry;
use crate::kernels::matrix::COLUMNS;
use crate::march::Stride;
use crate::network::{Activations, GEOMETRY, Network};
use crate::occupancy::OccupancyGrid;
use crate::space::Space;
use compute::rng::Rng;
use half::f16;
use std::ops::Range;

/// Samples that pass through the density network together; their activations stay in the
/// second-level cache.
const ROWS: usize = 256;

/// A hash-grid radiance field (Müller et al. 2022).
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    pub(crate) config: FieldConfig,
    pub(crate) space: Space,
    pub(crate) levels: Vec<Level>,
    pub(crate) table: Vec<Entry>,
    pub(crate) network: Network,
    pub(crate) occupancy: OccupancyGrid,
}

impl Field {
    /// A field that knows nothing yet: a nearly transparent haze. `bounds` is the scene box in
    /// world space.
    ///
    /// Panics if [`FieldConfig::check`] refuses the configuration or the box has no volume.
    pub fn new(config: &FieldConfig, bounds: [[f32; 3]; 2], seed: u64) -> Self {
        Self::in_space(config, Space::new(bounds), seed)
    }

    /// A field that knows nothing yet, in a space of any kind.
    ///
    /// Panics if [`FieldConfig::check`] refuses the configuration.
    pub fn in_space(config: &FieldConfig, space: Space, seed: u64) -> Self {
        assert_eq!(
            config.check(),
            Ok(()),
            "a field configuration is checked before it is used"
        );
        let levels = config.levels(space.extent);
        let entries: usize = levels.iter().map(|level| level.entries).sum();
        // instant-ngp's range: small, so that the first steps are the networks' own.
        let rng = Rng::new(seed, "hash table");
        let small =
            |i: usize, f: u64| 1e-4 * (2.0 * rng.uniform(0, (FEATURES * i) as u64 + f) - 1.0);
        let table = (0..entries)
            .map(|i| [small(i, 0), small(i, 1)].map(f16::from_f32))
            .collect();
        let network = Network::new(encoding_width(config), FEATURES * levels.len(), seed);
        let occupancy = OccupancyGrid::new(config.occupancy_resolution, &space);
        Self {
            config: config.clone(),
            space,
            levels,
            table,
            network,
            occupancy,
        }
    }

    /// The shape of the field.
    pub fn config(&self) -> &FieldConfig {
        &self.config
    }

    /// The scene box: lowest and highest corner in world space.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        self.space.bounds
    }

    /// Width of a row of hash features in memory.
    pub(crate) fn encoding_width(&self) -> usize {
        encoding_width(&self.config)
    }

    pub(crate) fn stride(&self) -> Stride {
        let cone = self.space.cone(&self.config) as f32;
        Stride {
            shortest: 1.0 / self.config.march_steps as f32,
            cone,
        }
    }

    /// Looks up the features at points in unit space.
    pub(crate) fn look_up(&self, points: impl Iterator<Item = [f32; 3]>, features: &mut Features) {
        features.clear(self);
        points.for_each(|point| features.positions.push(point));
        // Kernels take whole groups.
        features.positions.pad();
        features.look_ups(self).for_each(LookUp::run);
    }

    /// Looks up the features at points in world space. Points outside the box are taken as they
    /// are.
    pub(crate) fn look_up_in_world(&self, points: &[[f32; 3]]) -> Features {
        let mut features = Features::default();
        self.look_up(
            points
                .iter()
                // Cells begin at 0; below it look-ups would have negative indices.
                .map(|&point| self.space.to_unit(point).map(|x| x.max(0.0))),
            &mut features,
        );
        features
    }

    /// Adds the densities, per unit length, at some of the positions that were looked up.
    pub(crate) fn sigmas(
        &self,
        features: &Features,
        positions: Range<usize>,
        scratch: &mut Activations,
        sigmas: &mut Vec<f32>,
    ) {
        self.geometry(features, positions, scratch, |rows| {
            sigmas.extend(rows.chunks_exact(GEOMETRY).map(|row| sigma(row[0])));
        });
    }

    /// What the density network gives at some of the positions that were looked up, in order:
    /// `visit` gets some rows of [`GEOMETRY`] numbers at a time.
    pub(crate) fn geometry(
        &self,
        features: &Features,
        positions: Range<usize>,
        scratch: &mut Activations,
        mut visit: impl FnMut(&[f32]),
    ) {
        for first in positions.clone().step_by(ROWS) {
            let rows = first..positions.end.min(first + ROWS);
            let count = rows.len();
            features.rows(rows, self.encoding_width(), &mut scratch.encoding);
            self.network.density(scratch);
            visit(&scratch.geometry[..count * GEOMETRY]);
        }
    }

    /// Densities at points in world space, per world length. Points outside the box are taken as
    /// they are.
    pub fn densities(&self, points: &[[f32; 3]]) -> Vec<f32> {
        let mut sigmas = Vec::with_capacity(points.len());
        let features = self.look_up_in_world(points);
        self.sigmas(
            &features,
            0..points.len(),
            &mut Activations::default(),
            &mut sigmas,
        );
        sigmas
            .iter()
            .zip(points)
            .map(|(sigma, &point)| sigma * self.space.scale_at(point))
            .collect()
    }
}

/// The density of a raw network output, per unit length: exp(raw - 1).
#[inline(always)]
pub(crate) fn sigma(raw: f32) -> f32 {
    // Less 1, as nerfacc and DiSR-NeRF: a new field is thin haze, not fog.
    crate::exponential::exp(raw - 1.0)
}

/// The derivative of [`sigma`] where it is `sigma`, held back where it would explode: above
/// exp(15).
#[inline(always)]
pub(crate) fn sigma_backward(sigma: f32) -> f32 {
    // exp is its own derivative.
    sigma.min(3_269_017.4)
}

/// Width of a row of hash features in memory.
pub(crate) fn encoding_width(config: &FieldConfig) -> usize {
    (FEATURES * config.levels as usize).next_multiple_of(COLUMNS)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub const BOUNDS: [[f32; 3]; 2] = [[-1.0, 0.0, 2.0], [3.0, 1.0, 4.0]];

    pub fn small() -> FieldConfig {
        FieldConfig {
            levels: 5,
            log2_table: 8,
            finest_resolution: 40,
            occupancy_resolution: 8,
            ..Default::default()
        }
    }

    #[test]
    fn the_seed_decides_the_field() {
        assert_eq!(
            Field::new(&small(), BOUNDS, 7),
            Field::new(&small(), BOUNDS, 7)
        );
        assert_ne!(
            Field::new(&small(), BOUNDS, 7),
            Field::new(&small(), BOUNDS, 8)
        );
    }

    #[test]
    fn a_new_field_is_a_thin_haze_per_world_length() {
        let densities =
            Field::new(&small(), BOUNDS, 7).densities(&[[0.0, 0.5, 3.0], [1.0, 0.1, 2.5]]);
        for density in densities {
            assert!(
                (density - (-1f32).exp() / 4.0).abs() < 1e-3,
                "{density}: the longest side is 4"
            );
        }
    }
}
