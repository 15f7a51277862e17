//! A radiance field: its box, hash table, networks and occupancy, and how they go to and come from named tensors. Knows
//! nothing of cameras or training.

use crate::config::{FEATURES, FieldConfig, Level};
use crate::features::{Features, LookUp};
use crate::kernels::hash::Entry;
use crate::kernels::matrix::COLUMNS;
use crate::march::Stride;
use crate::network::{Activations, GEOMETRY, Layer, Network};
use crate::occupancy::OccupancyGrid;
use crate::perspective::Perspective;
use crate::space::Space;
use compute::rng::Rng;
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
    #[error("the scene box {0:?} must have finite corners, the first below the second on every axis")]
    Bounds([[f32; 3]; 2]),
    /// The map to unit space is none.
    #[error("tensors \"world_to_unit\" and \"unit_extent\" are no map from the scene to a space with sides of up to 1")]
    Perspective,
    /// A tensor is not there.
    #[error("tensor \"{0}\" is missing")]
    Missing(String),
    /// A tensor has another shape than the configuration says.
    #[error("tensor \"{name}\" has shape {found:?}; this configuration and box need {expected:?}")]
    Shape {
        /// Its name.
        name: String,
        /// Its shape.
        found: Vec<usize>,
        /// The shape it should have.
        expected: Vec<usize>,
    },
    /// A tensor holds something that is not a finite number.
    #[error("tensor \"{0}\" holds a value that is not finite")]
    NotFinite(String),
}

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
    /// A field that knows nothing yet: a nearly transparent haze. `bounds` is the scene box in world space.
    ///
    /// Panics if [`FieldConfig::check`] refuses the configuration or the box has no volume.
    pub fn new(config: &FieldConfig, bounds: [[f32; 3]; 2], seed: u64) -> Self {
        Self::in_space(config, Space::new(bounds), seed)
    }

    /// A field that knows nothing yet, in a space of any kind.
    ///
    /// Panics if [`FieldConfig::check`] refuses the configuration.
    pub fn in_space(config: &FieldConfig, space: Space, seed: u64) -> Self {
        assert_eq!(config.check(), Ok(()), "a field configuration is checked before it is used");
        let levels = config.levels(space.extent);
        let entries: usize = levels.iter().map(|level| level.entries).sum();
        let rng = Rng::new(seed, "hash table");
        let small = |i: usize, f: u64| 1e-4 * (2.0 * rng.uniform(0, (FEATURES * i) as u64 + f) - 1.0);
        let table = (0..entries).map(|i| [small(i, 0), small(i, 1)].map(f16::from_f32)).collect();
        let network = Network::new(encoding_width(config), FEATURES * levels.len(), seed);
        let occupancy = OccupancyGrid::new(config.occupancy_resolution, &space);
        Self { config: config.clone(), space, levels, table, network, occupancy }
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
        Stride { shortest: 1.0 / self.config.march_steps as f32, cone }
    }

    /// The density network's outputs at points in unit space.
    pub(crate) fn density(
        &self,
        points: impl ExactSizeIterator<Item = [f32; 3]>,
        features: &mut Features,
        activations: &mut Activations,
    ) {
        let count = points.len();
        features.clear(self);
        points.for_each(|point| features.positions.push(point));
        features.positions.pad();
        features.look_ups(self).for_each(LookUp::run);
        features.rows(0..count, self.encoding_width(), &mut activations.encoding);
        self.network.density(activations);
    }

    /// Densities at points in world space, per world length. Points outside the box are taken as they are.
    pub fn densities(&self, points: &[[f32; 3]]) -> Vec<f32> {
        let mut activations = Activations::default();
        let inside = points.iter().map(|&point| self.space.to_unit(point).map(|x| x.max(0.0)));
        self.density(inside, &mut Features::default(), &mut activations);
        let rows = activations.geometry.chunks_exact(GEOMETRY).take(points.len());
        rows.zip(points).map(|(row, &point)| sigma(row[0]) * self.space.scale_at(point)).collect()
    }

    /// Everything the field holds, by name. Matrices are [outputs, inputs]; hash entries are halves, exact as f32.
    pub fn tensors(&self) -> Tensors {
        let mut tensors = Tensors::new();
        let table = self.table.as_flattened().iter().map(|half| half.to_f32()).collect();
        tensors.insert("hash_table".into(), (vec![self.table.len(), FEATURES], table));
        tensors.extend(network_tensors(&self.network, ""));
        let [nx, ny, nz] = self.occupancy.size;
        tensors.insert("occupancy".into(), (vec![nz, ny, nx], self.occupancy.values.clone()));
        tensors.insert("occupancy_updates".into(), (vec![1], vec![self.occupancy.updates as f32]));
        if let Some(perspective) = self.space.perspective() {
            tensors.insert("world_to_unit".into(), (vec![4, 4], perspective.matrix.as_flattened().to_vec()));
            tensors.insert("unit_extent".into(), (vec![3], self.space.extent.to_vec()));
        }
        tensors
    }

    /// The field that [`Field::tensors`] was called on. Hash entries that are no halves are rounded to the nearest.
    pub fn from_tensors(config: &FieldConfig, bounds: [[f32; 3]; 2], tensors: &Tensors) -> Result<Self, FieldError> {
        config.check().map_err(FieldError::Config)?;
        let finite = bounds.as_flattened().iter().all(|x| x.is_finite());
        if !finite || (0..3).any(|axis| bounds[0][axis] >= bounds[1][axis]) {
            return Err(FieldError::Bounds(bounds));
        }
        let space = read_space(bounds, tensors)?;
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
        Ok(Self { config: config.clone(), space, levels, table, network, occupancy })
    }
}

/// The density of a raw network output, per unit length: exp(raw - 1).
#[inline(always)]
pub(crate) fn sigma(raw: f32) -> f32 {
    crate::exponential::exp(raw - 1.0)
}

/// The derivative of [`sigma`] where it is `sigma`, held back where it would explode: above exp(15).
#[inline(always)]
pub(crate) fn sigma_backward(sigma: f32) -> f32 {
    sigma.min(3_269_017.4)
}

fn encoding_width(config: &FieldConfig) -> usize {
    (FEATURES * config.levels as usize).next_multiple_of(COLUMNS)
}

/// Hash entries rounded to halves; what is too large becomes the largest half.
fn halves(values: &[f32]) -> Vec<Entry> {
    let half = |x: f32| f16::from_f32(x.clamp(-f16::MAX.to_f32(), f16::MAX.to_f32()));
    values.as_chunks::<FEATURES>().0.iter().map(|entry| entry.map(half)).collect()
}

/// The space of a box, or that of the perspective map that is among the tensors.
fn read_space(bounds: [[f32; 3]; 2], tensors: &Tensors) -> Result<Space, FieldError> {
    if !tensors.contains_key("world_to_unit") {
        return Ok(Space::new(bounds));
    }
    let (rows, extent) = (take(tensors, "world_to_unit", &[4, 4])?, take(tensors, "unit_extent", &[3])?);
    let map = Perspective::new(std::array::from_fn(|row| std::array::from_fn(|column| rows[4 * row + column])));
    let extent: [f32; 3] = std::array::from_fn(|axis| extent[axis]);
    if !map.is_whole() || extent.iter().any(|side| !(1e-6..=1.0).contains(side)) {
        return Err(FieldError::Perspective);
    }
    Ok(Space::in_perspective(bounds, map, extent))
}

/// A tensor's values, after checking its name, shape and finiteness.
pub(crate) fn take<'a>(tensors: &'a Tensors, name: &str, shape: &[usize]) -> Result<&'a [f32], FieldError> {
    let (found, values) = tensors.get(name).ok_or_else(|| FieldError::Missing(name.into()))?;
    if found != shape || values.len() != shape.iter().product::<usize>() {
        return Err(FieldError::Shape { name: name.into(), found: found.clone(), expected: shape.to_vec() });
    }
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
        let values = (0..inputs * outputs).map(|i| matrix[i % inputs * layer.outputs + i / inputs]).collect();
        (format!("{prefix}{}", layer.name), (vec![outputs, inputs], values))
    };
    network.layers.iter().enumerate().map(|(l, layer)| turned(l, layer)).collect()
}

/// The inverse of [`network_tensors`].
pub(crate) fn read_network(network: &mut Network, prefix: &str, tensors: &Tensors) -> Result<(), FieldError> {
    for (l, layer) in network.layers.clone().iter().enumerate() {
        let [inputs, outputs] = layer.used;
        let values = take(tensors, &format!("{prefix}{}", layer.name), &[outputs, inputs])?;
        let matrix = network.matrix_mut(l);
        values.iter().enumerate().for_each(|(i, &v)| matrix[i % inputs * layer.outputs + i / inputs] = v);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::SpaceKind;
    use glam::DMat4;
    use scene::Camera;

    const BOUNDS: [[f32; 3]; 2] = [[-1.0, 0.0, 2.0], [3.0, 1.0, 4.0]];

    fn small() -> FieldConfig {
        FieldConfig { levels: 5, log2_table: 8, finest_resolution: 40, occupancy_resolution: 8, ..Default::default() }
    }

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
        assert_eq!(Field::from_tensors(&small(), BOUNDS, &tensors), Err(FieldError::Perspective));
    }

    #[test]
    fn what_is_wrong_with_tensors_is_named() {
        let tensors = Field::new(&small(), BOUNDS, 7).tensors();
        let error = |change: &dyn Fn(&mut Tensors)| {
            let mut changed = tensors.clone();
            change(&mut changed);
            Field::from_tensors(&small(), BOUNDS, &changed).unwrap_err().to_string()
        };
        assert_eq!(error(&|t| drop(t.remove("hash_table"))), "tensor \"hash_table\" is missing");
        let shape = error(&|t| t.get_mut("color.2.weight").unwrap().0 = vec![4, 64]);
        assert_eq!(shape, "tensor \"color.2.weight\" has shape [4, 64]; this configuration and box need [3, 64]");
        let short = error(&|t| t.get_mut("occupancy").unwrap().1.truncate(5));
        assert!(short.starts_with("tensor \"occupancy\" has shape"), "{short}");
        let nan = error(&|t| t.get_mut("density.1.weight").unwrap().1[3] = f32::NAN);
        assert_eq!(nan, "tensor \"density.1.weight\" holds a value that is not finite");
        let flat = [[0.0; 3], [1.0, 0.0, 1.0]];
        assert_eq!(Field::from_tensors(&small(), flat, &tensors), Err(FieldError::Bounds(flat)));
    }

    #[test]
    fn the_seed_decides_the_field() {
        assert_eq!(Field::new(&small(), BOUNDS, 7), Field::new(&small(), BOUNDS, 7));
        assert_ne!(Field::new(&small(), BOUNDS, 7), Field::new(&small(), BOUNDS, 8));
    }

    #[test]
    fn a_new_field_is_a_thin_haze_per_world_length() {
        let densities = Field::new(&small(), BOUNDS, 7).densities(&[[0.0, 0.5, 3.0], [1.0, 0.1, 2.5]]);
        for density in densities {
            assert!((density - (-1f32).exp() / 4.0).abs() < 1e-3, "{density}: the longest side is 4");
        }
    }
}
