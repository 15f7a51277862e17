//! A field as named tensors, and back; what is missing, has another shape or is no number is named.
//! Knows no files.

use crate::config::{FEATURES, FieldConfig};
use crate::field::{Field, encoding_width};
use crate::kernels::hash::Entry;
use crate::network::{Layer, Network};
use crate::occupancy::OccupancyGrid;
use crate::perspective::Perspective;
use crate::space::Space;
use half::f16;
use std::collections::BTreeMap;

/// Tensors by name: shape and row-major values.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Why tensors do not make a field or a trainer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// The configuration is out of range.
    #[error("field configuration: {0}")]
    Config(String),
    /// The box is empty or not finite.
    #[error(
        "the scene box {0:?} must have finite corners, the first below the second on every axis"
    )]
    Bounds([[f32; 3]; 2]),
    /// The map to unit space is none.
    #[error(
        "tensors \"world_to_unit\" and \"unit_extent\" are no map from the scene to a space with sides of up to 1"
    )]
    Perspective,
    /// A tensor is not there.
    #[error("tensor \"{0}\" is missing")]
    Missing(String),
    /// A tensor has another shape than the configuration says.
    #[error("tensor \"{name}\" has shape {found:?}; this configuration and box need {expected:?}")]
    Shape {
        /// Its name among the field's tensors.
        name: String,
        /// The shape it has.
        found: Vec<usize>,
        /// The shape it should have.
        expected: Vec<usize>,
    },
    /// A tensor holds something that is not a finite number.
    #[error("tensor \"{0}\" holds a value that is not finite")]
    NotFinite(String),
}

impl Field {
    /// Everything the field holds, by name. Matrices are [outputs, inputs]; hash entries are
    /// halves, exact as f32.
    pub fn tensors(&self) -> Tensors {
        let mut tensors = Tensors::new();
        let table = self
            .table
            .as_flattened()
            .iter()
            .map(|half| half.to_f32())
            .collect();
        tensors.insert(
            "hash_table".into(),
            (vec![self.table.len(), FEATURES], table),
        );
        tensors.extend(network_tensors(&self.network, ""));
        let [nx, ny, nz] = self.occupancy.size;
        tensors.insert(
            "occupancy".into(),
            (vec![nz, ny, nx], self.occupancy.values.clone()),
        );
        tensors.insert(
            "occupancy_updates".into(),
            (vec![1], vec![self.occupancy.updates as f32]),
        );
        if let Some(perspective) = self.space.perspective() {
            tensors.insert(
                "world_to_unit".into(),
                (vec![4, 4], perspective.matrix.as_flattened().to_vec()),
            );
            tensors.insert("unit_extent".into(), (vec![3], self.space.extent.to_vec()));
        }
        tensors
    }

    /// The field that [`Field::tensors`] was called on. Hash entries that are no halves are rounded
    /// to the nearest.
    pub fn from_tensors(
        config: &FieldConfig,
        bounds: [[f32; 3]; 2],
        tensors: &Tensors,
    ) -> Result<Self, FieldError> {
        config.check().map_err(FieldError::Config)?;
        let finite = bounds.as_flattened().iter().all(|x| x.is_finite());
        if !finite || (0..3).any(|axis| bounds[0][axis] >= bounds[1][axis]) {
            return Err(FieldError::Bounds(bounds));
        }
        let space = read_space(bounds, tensors)?;
        // After the space, whose extent decides how many vertices a level has.
        let levels = config.levels(space.extent);
        let entries = levels.iter().map(|level| level.entries).sum();
        let table = halves(take(tensors, "hash_table", &[entries, FEATURES])?);
        let mut network = Network::zeros(encoding_width(config), FEATURES * levels.len());
        read_network(&mut network, "", tensors)?;
        let mut occupancy = OccupancyGrid::new(config.occupancy_resolution, &space);
        let [nx, ny, nz] = occupancy.size;
        occupancy.values = take(tensors, "occupancy", &[nz, ny, nx])?.to_vec();
        occupancy.updates = take(tensors, "occupancy_updates", &[1])?[0] as u32;
        occupancy.refresh();
        Ok(Self {
            config: config.clone(),
            space,
            levels,
            table,
            network,
            occupancy,
        })
    }
}

/// Hash entries rounded to halves; what is too large becomes the largest half.
fn halves(values: &[f32]) -> Vec<Entry> {
    // Infinity would spread through every look-up that touches it.
    let half = |x: f32| f16::from_f32(x.clamp(-f16::MAX.to_f32(), f16::MAX.to_f32()));
    values
        .as_chunks::<FEATURES>()
        .0
        .iter()
        .map(|entry| entry.map(half))
        .collect()
}

/// The space of a box, or that of the perspective map that is among the tensors.
fn read_space(bounds: [[f32; 3]; 2], tensors: &Tensors) -> Result<Space, FieldError> {
    if !tensors.contains_key("world_to_unit") {
        return Ok(Space::new(bounds));
    }
    let rows = take(tensors, "world_to_unit", &[4, 4])?;
    let extent = take(tensors, "unit_extent", &[3])?;
    let map = Perspective::new(std::array::from_fn(|row| {
        std::array::from_fn(|column| rows[4 * row + column])
    }));
    let extent: [f32; 3] = std::array::from_fn(|axis| extent[axis]);
    // A side of nearly 0 would be divided by.
    if !map.is_whole() || extent.iter().any(|side| !(1e-6..=1.0).contains(side)) {
        return Err(FieldError::Perspective);
    }
    Ok(Space::in_perspective(bounds, map, extent))
}

/// A tensor's values, after checking its name, shape and finiteness.
pub(crate) fn take<'a>(
    tensors: &'a Tensors,
    name: &str,
    shape: &[usize],
) -> Result<&'a [f32], FieldError> {
    let (found, values) = tensors
        .get(name)
        .ok_or_else(|| FieldError::Missing(name.into()))?;
    if found != shape || values.len() != shape.iter().product::<usize>() {
        return Err(FieldError::Shape {
            name: name.into(),
            found: found.clone(),
            expected: shape.to_vec(),
        });
    }
    // One NaN would spread through every ray that meets it, and through training to all weights.
    if values.iter().any(|x| !x.is_finite()) {
        return Err(FieldError::NotFinite(name.into()));
    }
    Ok(values)
}

/// The matrices of a network (or of something of its shape, such as Adam's moments) under `prefix`.
pub(crate) fn network_tensors(network: &Network, prefix: &str) -> Tensors {
    let turned = |l: usize, layer: &Layer| {
        let [inputs, outputs] = layer.used;
        let matrix = network.matrix(l);
        let values = (0..inputs * outputs)
            .map(|i| matrix[i % inputs * layer.outputs + i / inputs])
            .collect();
        (
            format!("{prefix}{}", layer.name),
            (vec![outputs, inputs], values),
        )
    };
    network
        .layers
        .iter()
        .enumerate()
        .map(|(l, layer)| turned(l, layer))
        .collect()
}

/// The inverse of [`network_tensors`].
pub(crate) fn read_network(
    network: &mut Network,
    prefix: &str,
    tensors: &Tensors,
) -> Result<(), FieldError> {
    for (l, layer) in network.layers.clone().iter().enumerate() {
        let [inputs, outputs] = layer.used;
        let values = take(
            tensors,
            &format!("{prefix}{}", layer.name),
            &[outputs, inputs],
        )?;
        let matrix = network.matrix_mut(l);
        values
            .iter()
            .enumerate()
            .for_each(|(i, &v)| matrix[i % inputs * layer.outputs + i / inputs] = v);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tests::{BOUNDS, small};
    use crate::space::SpaceKind;
    use formats::Camera;
    use glam::DMat4;

    #[test]
    fn tensors_come_back_as_the_same_field() {
        let mut field = Field::new(&small(), BOUNDS, 7);
        field.occupancy.update(&[3, 5], &[0.0, 9.0]);
        let tensors = field.tensors();
        assert_eq!(tensors["density.0.weight"].0, [64, 10]);
        assert_eq!(tensors["color.2.weight"].0, [3, 64]);
        assert_eq!(tensors["occupancy"].0, [4, 2, 8]);
        assert_eq!(Field::from_tensors(&small(), BOUNDS, &tensors), Ok(field));
    }

    #[test]
    fn a_space_in_perspective_comes_back_too() {
        let camera = Camera::centered((8, 6), 8.0, DMat4::IDENTITY, [1.0, 5.0]);
        let space = Space::of(SpaceKind::Perspective, BOUNDS, &[&camera]).unwrap();
        let field = Field::in_space(&small(), space, 7);
        let mut tensors = field.tensors();
        assert_eq!(Field::from_tensors(&small(), BOUNDS, &tensors), Ok(field));
        tensors.get_mut("world_to_unit").unwrap().1.fill(0.0);
        assert_eq!(
            Field::from_tensors(&small(), BOUNDS, &tensors),
            Err(FieldError::Perspective)
        );
    }

    #[test]
    fn what_is_wrong_with_tensors_is_named() {
        let tensors = Field::new(&small(), BOUNDS, 7).tensors();
        let error = |change: &dyn Fn(&mut Tensors)| {
            let mut changed = tensors.clone();
            change(&mut changed);
            Field::from_tensors(&small(), BOUNDS, &changed)
                .unwrap_err()
                .to_string()
        };
        assert_eq!(
            error(&|t| drop(t.remove("hash_table"))),
            "tensor \"hash_table\" is missing"
        );
        let shape = error(&|t| t.get_mut("color.2.weight").unwrap().0 = vec![4, 64]);
        assert_eq!(
            shape,
            "tensor \"color.2.weight\" has shape [4, 64]; this configuration and box need [3, 64]"
        );
        let short = error(&|t| t.get_mut("occupancy").unwrap().1.truncate(5));
        assert!(
            short.starts_with("tensor \"occupancy\" has shape"),
            "{short}"
        );
        let nan = error(&|t| t.get_mut("density.1.weight").unwrap().1[3] = f32::NAN);
        assert_eq!(
            nan,
            "tensor \"density.1.weight\" holds a value that is not finite"
        );
        let flat = [[0.0; 3], [1.0, 0.0, 1.0]];
        assert_eq!(
            Field::from_tensors(&small(), flat, &tensors),
            Err(FieldError::Bounds(flat))
        );
    }
}
