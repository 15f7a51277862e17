//! A frozen linear layer with room for an adapter: `y = x W^T + b + (alpha/r) (x A^T) B^T`.
//!
//! The adapted weight is never formed: the frozen network and the adapted one share W.

use compute::Array;
use compute::elementwise::{add, scale, scaled_sum};
use compute::linear::{linear, linear_backward_input, linear_backward_weight};

use crate::error::ModelError;
use crate::layers::Linear;
use crate::lora::{AdapterSite, LoraGradients, LoraNetwork};
use crate::weights::Scope;

/// A linear layer that an adapter may follow.
pub(crate) struct Projection {
    linear: Linear,
    site: AdapterSite,
}

/// What the backward pass needs: the input, and the input times A^T.
pub(crate) struct ProjectionTape {
    x: Array,
    reduced: Option<Array>,
}

impl ProjectionTape {
    /// How many samples, or texts, the input holds.
    pub fn samples(&self) -> usize {
        self.x.shape()[0]
    }

    /// The bytes that it holds.
    pub fn bytes(&self) -> usize {
        4 * (self.x.len() + self.reduced.as_ref().map_or(0, Array::len))
    }
}

impl Projection {
    pub fn read(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        let site = AdapterSite::new(scope.path(), inputs, outputs);
        Ok(Self {
            linear: Linear::read(scope, inputs, outputs)?,
            site,
        })
    }

    pub fn without_bias(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        let site = AdapterSite::new(scope.path(), inputs, outputs);
        Ok(Self {
            linear: Linear::without_bias(scope, inputs, outputs)?,
            site,
        })
    }

    pub fn site(&self) -> &AdapterSite {
        &self.site
    }

    /// `x W^T + b`.
    pub fn frozen(&self, x: &Array) -> Array {
        self.linear.forward(x)
    }

    pub fn forward(&self, x: &Array, lora: Option<&LoraNetwork>) -> (Array, ProjectionTape) {
        self.adapt(x, &self.linear.forward(x), lora)
    }

    /// The whole, given the frozen part of it, `y`.
    pub fn adapt(
        &self,
        x: &Array,
        y: &Array,
        lora: Option<&LoraNetwork>,
    ) -> (Array, ProjectionTape) {
        let Some((lora, (down, up))) =
            lora.and_then(|lora| Some((lora, lora.adapter(&self.site)?)))
        else {
            return (
                y.clone(),
                ProjectionTape {
                    x: x.clone(),
                    reduced: None,
                },
            );
        };
        // [.., r]: with so few numbers a token, two thin products cost less than forming B A.
        let reduced = linear(x, down, None);
        let y = scaled_sum(&[
            (1.0, y),
            (lora.scale(&self.site), &linear(&reduced, up, None)),
        ]);
        (
            y,
            ProjectionTape {
                x: x.clone(),
                reduced: Some(reduced),
            },
        )
    }

    /// The gradient by the input; those by A and B go into `gradients`.
    pub fn backward(
        &self,
        tape: &ProjectionTape,
        dy: &Array,
        lora: Option<&LoraNetwork>,
        gradients: &mut LoraGradients,
    ) -> Array {
        // The input went two ways, through W and through A and B: both gradients add up.
        let dx = self.linear.backward(dy);
        let reduced = self.backward_adapter(tape, dy, lora, gradients);
        match reduced.zip(lora.and_then(|lora| lora.adapter(&self.site))) {
            Some((reduced, (down, _))) => add(&dx, &linear_backward_input(&reduced, down)),
            None => dx,
        }
    }

    /// The gradients by A and B alone; gives that by `x A^T`, if there is an adapter.
    pub fn backward_adapter(
        &self,
        tape: &ProjectionTape,
        dy: &Array,
        lora: Option<&LoraNetwork>,
        gradients: &mut LoraGradients,
    ) -> Option<Array> {
        let lora = lora?;
        // No entry means that the forward pass had no adapter here, and nothing to learn.
        let reduced = tape.reduced.as_ref()?;
        let (_, up) = lora.adapter(&self.site)?;
        let factor = lora.scale(&self.site);
        // alpha / r multiplies the product of A and B, so it stands in both gradients.
        let reduced_gradient = scale(&linear_backward_input(dy, up), factor);
        let up_gradient = scale(&linear_backward_weight(reduced, dy), factor);
        gradients.adapters.insert(self.site.up.clone(), up_gradient);
        gradients.adapters.insert(
            self.site.down.clone(),
            linear_backward_weight(&tape.x, &reduced_gradient),
        );
        Some(reduced_gradient)
    }
}
