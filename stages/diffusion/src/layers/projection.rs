//! A frozen linear layer with room for an adapter: `y = x W^T + b + (alpha/r) (x A^T) B^T`.
//!
//! The adapted weight is never formed: the frozen network and the adapted one share W.

use compute::Array;
use compute::elementwise::{scale, scaled_sum};
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

impl Projection {
    pub fn read(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        let site = AdapterSite::new(scope.path(), inputs, outputs);
        Ok(Self { linear: Linear::read(scope, inputs, outputs)?, site })
    }

    pub fn without_bias(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self, ModelError> {
        let site = AdapterSite::new(scope.path(), inputs, outputs);
        Ok(Self { linear: Linear::without_bias(scope, inputs, outputs)?, site })
    }

    pub fn site(&self) -> &AdapterSite {
        &self.site
    }

    pub fn forward(&self, x: &Array, lora: Option<&LoraNetwork>) -> (Array, ProjectionTape) {
        let y = self.linear.forward(x);
        let Some((lora, (down, up))) = lora.and_then(|lora| Some((lora, lora.adapter(&self.site)?))) else {
            return (y, ProjectionTape { x: x.clone(), reduced: None });
        };
        let reduced = linear(x, down, None);
        let y = scaled_sum(&[(1.0, &y), (lora.scale(), &linear(&reduced, up, None))]);
        (y, ProjectionTape { x: x.clone(), reduced: Some(reduced) })
    }

    /// The gradient by the input; those by A and B go into `gradients`.
    pub fn backward(
        &self,
        tape: &ProjectionTape,
        dy: &Array,
        lora: Option<&LoraNetwork>,
        gradients: &mut LoraGradients,
    ) -> Array {
        let dx = self.linear.backward(dy);
        match self.backward_adapter(tape, dy, lora, gradients) {
            Some(through_adapter) => compute::elementwise::add(&dx, &through_adapter),
            None => dx,
        }
    }

    /// The gradients by A and B alone; the part of the input's gradient that flows through the adapter, if there is one.
    pub fn backward_adapter(
        &self,
        tape: &ProjectionTape,
        dy: &Array,
        lora: Option<&LoraNetwork>,
        gradients: &mut LoraGradients,
    ) -> Option<Array> {
        let (lora, reduced) = (lora?, tape.reduced.as_ref()?);
        let (down, up) = lora.adapter(&self.site)?;
        let reduced_gradient = scale(&linear_backward_input(dy, up), lora.scale());
        let up_gradient = scale(&linear_backward_weight(reduced, dy), lora.scale());
        gradients.adapters.insert(self.site.up.clone(), up_gradient);
        gradients.adapters.insert(self.site.down.clone(), linear_backward_weight(&tape.x, &reduced_gradient));
        Some(linear_backward_input(&reduced_gradient, down))
    }
}
