//! Frozen normalisations.

use compute::Array;
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm, layer_norm_backward};

use crate::error::ModelError;
use crate::weights::Scope;

/// Group normalisation over `[N, C, ..]`, and what follows it.
pub(crate) struct GroupNorm {
    gamma: Array,
    beta: Array,
    groups: usize,
    eps: f32,
    activation: Activation,
}

impl GroupNorm {
    pub fn read(
        scope: &Scope,
        channels: usize,
        groups: usize,
        eps: f32,
        activation: Activation,
    ) -> Result<Self, ModelError> {
        let (gamma, beta) = (scope.tensor("weight", &[channels])?, scope.tensor("bias", &[channels])?);
        Ok(Self { gamma, beta, groups, eps, activation })
    }

    pub fn forward(&self, x: &Array) -> Array {
        group_norm(x, &self.gamma, &self.beta, self.groups, self.eps, self.activation)
    }

    /// `x` is the input of the forward pass.
    pub fn backward(&self, x: &Array, dy: &Array) -> Array {
        group_norm_backward(x, &self.gamma, &self.beta, self.groups, self.eps, self.activation, dy)
    }
}

/// Normalisation of the last axis.
pub(crate) struct LayerNorm {
    gamma: Array,
    beta: Array,
    eps: f32,
}

impl LayerNorm {
    pub fn read(scope: &Scope, channels: usize, eps: f32) -> Result<Self, ModelError> {
        Ok(Self { gamma: scope.tensor("weight", &[channels])?, beta: scope.tensor("bias", &[channels])?, eps })
    }

    pub fn forward(&self, x: &Array) -> Array {
        layer_norm(x, &self.gamma, &self.beta, self.eps)
    }

    /// `x` is the input of the forward pass.
    pub fn backward(&self, x: &Array, dy: &Array) -> Array {
        layer_norm_backward(x, &self.gamma, self.eps, dy)
    }
}
