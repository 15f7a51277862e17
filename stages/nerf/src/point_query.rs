//! Point queries: colours and densities of a field at single points rather than along rays, and how
//! much of its box is occupied. Knows nothing of cameras.

use crate::exponential::sigmoid;
use crate::field::Field;
use crate::network::{Activations, COLOR_OUTPUT};

/// How much of a field's box may hold something, in cells of its occupancy grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OccupancyCounts {
    /// All cells of the grid.
    pub cells: usize,
    /// Those that some camera sees.
    pub seen: usize,
    /// Those that may hold something.
    pub occupied: usize,
}

impl Field {
    /// Colours at points in world space, each seen along its own unit direction, in the space the
    /// field was trained in.
    pub fn colors(&self, points: &[[f32; 3]], directions: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let mut activations = Activations::default();
        let features = self.look_up_in_world(points);
        features.rows(
            0..points.len(),
            self.encoding_width(),
            &mut activations.encoding,
        );
        self.network.density(&mut activations);
        // A point is a ray of its own here, with its own direction.
        activations.set_directions(
            directions
                .iter()
                .enumerate()
                .map(|(row, &direction)| (direction, row..row + 1)),
        );
        self.network.color(&mut activations);
        let raw = activations
            .color
            .chunks_exact(COLOR_OUTPUT)
            .take(points.len());
        raw.map(|row| std::array::from_fn(|channel| sigmoid(row[channel])))
            .collect()
    }

    /// Densities at points in world space, per world length, as rays meet them: none outside the
    /// box, nor where the occupancy grid holds nothing.
    pub fn visible_densities(&self, points: &[[f32; 3]]) -> Vec<f32> {
        let visible = |point: &[f32; 3]| {
            let unit = self.space.to_unit(*point);
            let inside = (0..3).all(|axis| (0.0..=self.space.extent[axis]).contains(&unit[axis]));
            // Without this, haze would be seen that no ray meets, since it skips empty cells.
            inside && self.occupancy.occupied(self.occupancy.cell(unit))
        };
        let mask: Vec<bool> = points.iter().map(visible).collect();
        let asked: Vec<[f32; 3]> = points
            .iter()
            .zip(&mask)
            .filter(|(_, mask)| **mask)
            .map(|(p, _)| *p)
            .collect();
        let mut densities = self.densities(&asked).into_iter();
        mask.into_iter()
            .map(|visible| {
                if visible {
                    densities.next().unwrap_or(0.0)
                } else {
                    0.0
                }
            })
            .collect()
    }

    /// Counts the cells of the occupancy grid. They are those of the last occupancy update.
    pub fn occupancy_counts(&self) -> OccupancyCounts {
        OccupancyCounts {
            cells: self.occupancy.cells(),
            seen: self.occupancy.seen_cells().len(),
            occupied: self.occupancy.occupied_cells().len(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FieldConfig;

    #[test]
    fn a_new_field_is_grey_from_everywhere_and_full() {
        let config = FieldConfig {
            levels: 2,
            log2_table: 8,
            occupancy_resolution: 4,
            ..FieldConfig::default()
        };
        let field = Field::new(&config, [[0.0; 3], [2.0, 1.0, 1.0]], 1);
        for [r, g, b] in field.colors(
            &[[0.1; 3], [1.9, 0.2, 0.3]],
            &[[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        ) {
            assert!(
                [r, g, b].iter().all(|value| (0.05..0.95).contains(value)),
                "{r} {g} {b}"
            );
        }
        let densities =
            field.visible_densities(&[[1.0, 0.5, 0.5], [1.0, 0.5, 1.1], [-0.1, 0.5, 0.5]]);
        assert!(
            densities[0] > 0.0 && densities[1..] == [0.0; 2],
            "outside there is nothing: {densities:?}"
        );
        assert_eq!(
            field.occupancy_counts(),
            OccupancyCounts {
                cells: 16,
                seen: 16,
                occupied: 16
            }
        );
    }
}
