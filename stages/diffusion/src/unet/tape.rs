//! What a forward pass keeps for its backward pass: whole tapes as far as a budget goes, else
//! inputs to compute again from.
//!
//! Which of the two a layer gets changes time and memory, and never a bit of the gradients.

use compute::Array;

use super::layer::LayerTape;
use super::time::TimeTape;

/// What [`super::Unet::backward`] needs of a forward pass.
pub struct Tape {
    pub(super) size: [usize; 2],
    pub(super) time: TimeTape,
    /// The time embedding after its activation `[N, D]`.
    pub(super) embedding: Array,
    pub(super) layers: Vec<LayerTape>,
    pub(super) last: Array,
}

/// The layers' tapes so far.
pub(super) struct Kept {
    layers: Vec<LayerTape>,
    bytes: usize,
    budget: usize,
}

impl Kept {
    /// Nothing yet; `budget` is how many bytes may be kept beside the layers' inputs.
    pub fn new(budget: usize) -> Self {
        Self {
            layers: Vec::new(),
            bytes: 0,
            budget,
        }
    }

    /// Keeps one more tape. While all together exceed the budget, the largest is reduced to its
    /// layer's input.
    pub fn push(&mut self, tape: LayerTape) {
        self.bytes += tape.bytes();
        self.layers.push(tape);
        // Dropping the largest makes room with the fewest layers to compute again.
        while self.bytes > self.budget {
            let Some(largest) = self.layers.iter_mut().max_by_key(|tape| tape.bytes()) else {
                return;
            };
            self.bytes -= largest.bytes();
            // A reduced tape counts no bytes, so that the loop ends.
            largest.reduce();
        }
    }

    /// All tapes, in the order of the layers.
    pub fn into_layers(self) -> Vec<LayerTape> {
        self.layers
    }
}
