//! A trainer's whole state as named tensors, so that training can go on elsewhere with the same
//! bits. Knows nothing of files.

use crate::batch::TrainView;
use crate::config::{FEATURES, FieldConfig};
use crate::field::Field;
use crate::network::Network;
use crate::options::TrainOptions;
use crate::tensors::{FieldError, Tensors, network_tensors, read_network, take};
use crate::train::Trainer;

impl Trainer {
    /// Everything that the coming steps depend on besides the views, the options and the seed: the
    /// field, Adam's moments and counters, the step and the batch size. Whole numbers stand as f32,
    /// exact below 2^24; hash entries have the full precision that steps are taken in.
    pub fn state(&self) -> Tensors {
        let mut tensors = self.field.tensors();
        let entries = self.field.table.len();
        let moments = &self.table_moments;
        let mut put = |name: &str, shape: &[usize], values: Vec<f32>| {
            tensors.insert(name.into(), (shape.to_vec(), values))
        };
        put(
            "hash_table",
            &[entries, FEATURES],
            moments.values.as_flattened().to_vec(),
        );
        let [first, second] = moments.unpacked();
        put("adam.first.hash_table", &[entries, FEATURES], first);
        put("adam.second.hash_table", &[entries, FEATURES], second);
        put(
            "adam.steps.hash_table",
            &[entries],
            moments.steps.iter().map(|&n| f32::from(n)).collect(),
        );
        // At most 10 million by the stages' checks, which f32 holds exactly.
        put("trainer.step", &[1], vec![self.step as f32]);
        // The batch's size follows from the samples before, so it is a part of the state.
        put("trainer.pixels", &[1], vec![self.pixels as f32]);
        tensors.extend(network_tensors(
            &self.like_network(&self.network_moments.first),
            "adam.first.",
        ));
        tensors.extend(network_tensors(
            &self.like_network(&self.network_moments.second),
            "adam.second.",
        ));
        tensors.extend(self.corrections.tensors());
        tensors
    }

    /// The trainer that [`Trainer::state`] was called on; `config`, `bounds`, views, options and
    /// seed are those it was made with.
    pub fn from_state(
        config: &FieldConfig,
        bounds: [[f32; 3]; 2],
        views: Vec<TrainView>,
        options: &TrainOptions,
        seed: u64,
        state: &Tensors,
    ) -> Result<Self, FieldError> {
        let mut trainer = Trainer::new(
            Field::from_tensors(config, bounds, state)?,
            views,
            options,
            seed,
        );
        let entries = trainer.field.table.len();
        let pairs = |name| take(state, name, &[entries, FEATURES]);
        trainer.table_moments.values = pairs("hash_table")?.as_chunks().0.to_vec();
        trainer.table_moments.pack([
            pairs("adam.first.hash_table")?,
            pairs("adam.second.hash_table")?,
        ]);
        trainer.table_moments.steps = take(state, "adam.steps.hash_table", &[entries])?
            .iter()
            .map(|&n| n as u16)
            .collect();
        trainer.network_moments.first = trainer.read_moment("adam.first.", state)?;
        trainer.network_moments.second = trainer.read_moment("adam.second.", state)?;
        // Cameras that were refined move the views, so that the next batch sees from there.
        trainer.corrections.read(state, &mut trainer.views)?;
        trainer.step = take(state, "trainer.step", &[1])?[0] as u32;
        // A state may come from other options or from another machine.
        trainer.pixels = trainer.within_limits(take(state, "trainer.pixels", &[1])?[0] as u32);
        Ok(trainer)
    }

    fn like_network(&self, values: &[f32]) -> Network {
        Network {
            layers: self.field.network.layers.clone(),
            weights: values.to_vec(),
        }
    }

    fn read_moment(&self, prefix: &str, state: &Tensors) -> Result<Vec<f32>, FieldError> {
        let mut moment = self.like_network(&self.network_moments.first);
        read_network(&mut moment, prefix, state)?;
        Ok(moment.weights)
    }
}
