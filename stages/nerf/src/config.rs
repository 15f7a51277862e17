//! The shape of a field: its hash levels, its grid of occupancy and its marching step. Knows
//! nothing of values.

use crate::space::Space;
use formats::Camera;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Features of one hash entry (F of Müller et al. 2022).
pub const FEATURES: usize = 2;

/// Growth of steps where cameras stand in the scene.
pub(crate) const CONE: f64 = 1.0 / 32.0;
/// Cameras at this distance from the box are away from the scene; its longest side is 1.
const AWAY: f32 = 0.25;

/// What fixes the tensors of a field and the steps of its rays. Lengths are in unit space (see
/// [`crate::Space`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FieldConfig {
    /// Hash levels (L).
    #[schemars(range(min = 1, max = 32))]
    pub levels: u32,
    /// Binary logarithm of the entries a level has at most (T).
    #[schemars(range(min = 4, max = 24))]
    pub log2_table: u32,
    /// Vertices along the box's longest side at the coarsest level (N_min).
    #[schemars(range(min = 2, max = 4096))]
    pub base_resolution: u32,
    /// Vertices along the box's longest side at the finest level (N_max).
    #[schemars(range(min = 2, max = 65536))]
    pub finest_resolution: u32,
    /// Occupancy cells along the box's longest side; cells are cubes.
    #[schemars(range(min = 1, max = 512))]
    pub occupancy_resolution: u32,
    /// Marching steps along the longest side of unit space, at their shortest.
    #[schemars(range(min = 8, max = 65536))]
    pub march_steps: u32,
    /// Growth of the marching step with the distance from the camera in a box; 0 keeps it constant.
    /// `None` goes by where the cameras stand: 0 if all are away from the box, by a quarter of its
    /// longest side at least, else 1/32. In perspective it is 0.
    #[schemars(range(min = 0, max = 0.25))]
    pub march_cone: Option<f64>,
}

/// Chosen by the held-out PSNR at full resolution of fields fitted to 60-pixel-wide photos
/// (`examples/fit.rs`; LLFF fern and the procedural still life): finer levels and longer tables
/// cost time and change nothing there, but the views that `Sync` brings later need them; shorter
/// steps only buy fewer pixels per batch.
impl Default for FieldConfig {
    fn default() -> Self {
        Self {
            levels: 16,
            log2_table: 17,
            base_resolution: 16,
            finest_resolution: 1024,
            occupancy_resolution: 96,
            march_steps: 128,
            march_cone: None,
        }
    }
}

impl FieldConfig {
    /// Says which value is out of range, and what would be in it.
    pub fn check(&self) -> Result<(), String> {
        within("levels", self.levels, 1, 32)?;
        within("log2_table", self.log2_table, 4, 24)?;
        within("base_resolution", self.base_resolution, 2, 4096)?;
        within(
            "finest_resolution",
            self.finest_resolution,
            self.base_resolution,
            1 << 16,
        )?;
        within("occupancy_resolution", self.occupancy_resolution, 1, 512)?;
        within("march_steps", self.march_steps, 8, 1 << 16)?;
        match self.march_cone {
            Some(cone) if !(0.0..=0.25).contains(&cone) => {
                Err(format!("march_cone is {cone}; it must be 0 to 0.25"))
            }
            _ => Ok(()),
        }
    }

    /// This configuration with every value known, as the cameras ask for it.
    ///
    /// From far away, a ray meets the near and the far side of a box at distances that differ by a
    /// small factor: growing steps would only be coarse all over. Held out, an object of 100 pixels
    /// gains 3.6 dB by even steps; the fox, whose cameras stand inside the box, loses 0.3, since
    /// more samples for each ray leave fewer rays.
    pub fn for_cameras(&self, space: &Space, cameras: &[&Camera]) -> Self {
        let away = |camera: &&Camera| space.distance_from_box(camera) >= AWAY;
        let even = space.perspective().is_some() || cameras.iter().all(away);
        let cone = if even { 0.0 } else { CONE };
        Self {
            march_cone: Some(self.march_cone.unwrap_or(cone)),
            ..self.clone()
        }
    }

    /// The levels of a box whose sides have the given lengths in unit space, coarse to fine.
    pub fn levels(&self, extent: [f32; 3]) -> Vec<Level> {
        let ratio = f64::from(self.finest_resolution) / f64::from(self.base_resolution);
        // One level has no growth; the 2 keeps the division finite.
        let growth = ratio.ln() / f64::from(self.levels.max(2) - 1);
        let mut offset = 0;
        let level = |l: u32| {
            // N_min counts vertices, of which cells have one less.
            let scale = f64::from(self.base_resolution) * (growth * f64::from(l)).exp() - 1.0;
            let level = Level::new(scale, extent, 1 << self.log2_table, offset);
            offset += level.entries;
            level
        };
        (0..self.levels).map(level).collect()
    }
}

fn within(name: &str, value: u32, low: u32, high: u32) -> Result<(), String> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(format!("{name} is {value}; it must be {low} to {high}"))
}

/// One resolution of the hash grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// Cells per unit of length: N_min b^l - 1.
    pub scale: f32,
    /// Vertices along each axis of the box.
    pub resolution: [u32; 3],
    /// Whether every vertex has an entry of its own; else vertices share entries by hash.
    pub dense: bool,
    /// Entries of this level.
    pub entries: usize,
    /// Entries of all coarser levels together.
    pub offset: usize,
}

impl Level {
    fn new(scale: f64, extent: [f32; 3], most_entries: usize, offset: usize) -> Self {
        // N_min e^(l ln b) misses whole numbers by rounding; a vertex more for that would change
        // the table's size.
        let resolution =
            extent.map(|side| (scale * f64::from(side) - 1e-6).ceil().max(1.0) as u32 + 1);
        // At most 2^16 a side, so that 64 bits hold the product.
        let vertices = resolution.iter().map(|&n| n as usize).product::<usize>();
        let dense = vertices <= most_entries;
        // Groups of eight, as Adam's vectors take them. A hashed level has 2^T, so that a hash is
        // cut by a mask.
        let entries = vertices.next_multiple_of(8).min(most_entries);
        Self {
            scale: scale as f32,
            resolution,
            dense,
            entries,
            offset,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat4;

    /// Sixteen levels up to 4096 vertices, as its NeRF configuration.
    fn instant_ngp() -> FieldConfig {
        FieldConfig {
            levels: 16,
            log2_table: 19,
            finest_resolution: 4096,
            ..FieldConfig::default()
        }
    }

    #[test]
    fn levels_have_the_sizes_of_instant_ngp() {
        let levels = instant_ngp().levels([1.0; 3]);
        let resolutions: Vec<u32> = levels.iter().map(|level| level.resolution[0]).collect();
        assert_eq!(
            resolutions,
            [
                16, 24, 34, 49, 71, 102, 148, 213, 308, 446, 646, 934, 1352, 1956, 2831, 4096
            ]
        );
        let entries: Vec<usize> = levels.iter().map(|level| level.entries).collect();
        assert_eq!(entries[..5], [4096, 13824, 39304, 117656, 357912]);
        assert!(
            entries[5..].iter().all(|&n| n == 524_288)
                && levels[5..].iter().all(|level| !level.dense)
        );
        assert_eq!(entries.iter().sum::<usize>(), 6_299_960);
        assert_eq!(levels[15].offset + levels[15].entries, 6_299_960);
    }

    #[test]
    fn a_flat_box_keeps_more_levels_dense() {
        let flat = instant_ngp().levels([1.0, 0.5, 0.1]);
        assert_eq!(flat[0].resolution, [16, 9, 3]);
        assert!(
            flat[7].dense,
            "213 x 107 x 23 vertices fit into 2^19 entries"
        );
    }

    #[test]
    fn a_bad_value_is_named() {
        let problem = FieldConfig {
            levels: 0,
            ..FieldConfig::default()
        }
        .check()
        .unwrap_err();
        assert_eq!(problem, "levels is 0; it must be 1 to 32");
        let problem = FieldConfig {
            march_cone: Some(f64::NAN),
            ..FieldConfig::default()
        }
        .check()
        .unwrap_err();
        assert!(problem.starts_with("march_cone is NaN"), "{problem}");
        assert_eq!(FieldConfig::default().check(), Ok(()));
    }

    #[test]
    fn steps_grow_only_where_a_camera_stands_near_the_scene() {
        let space = Space::new([[-1.0; 3], [1.0; 3]]);
        let camera = |z: f64| {
            let place = DMat4::from_translation([0.0, 0.0, z].into());
            Camera::centered((16, 12), 16.0, place, [0.1, 9.0])
        };
        let away = camera(4.0);
        let near = camera(1.2);
        let cone = |config: FieldConfig, cameras: &[&Camera]| {
            config.for_cameras(&space, cameras).march_cone.unwrap()
        };
        assert_eq!(cone(FieldConfig::default(), &[&away]), 0.0);
        assert_eq!(cone(FieldConfig::default(), &[&away, &near]), CONE);
        let told = FieldConfig {
            march_cone: Some(0.01),
            ..FieldConfig::default()
        };
        assert_eq!(cone(told, &[&away]), 0.01);
    }
}
