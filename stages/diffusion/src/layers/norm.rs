//! Frozen normalisations.

use compute::Array;
use compute::elementwise::sub;
use compute::norm::{Activation, group_norm, group_norm_backward, layer_norm, layer_norm_backward};

use compute::reduce::{mean, mean_square};
use compute::shape::slice;

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
        let gamma = scope.tensor("weight", &[channels])?;
        let beta = scope.tensor("bias", &[channels])?;
        Ok(Self {
            gamma,
            beta,
            groups,
            eps,
            activation,
        })
    }

    pub fn forward(&self, x: &Array) -> Array {
        group_norm(
            x,
            &self.gamma,
            &self.beta,
            self.groups,
            self.eps,
            self.activation,
        )
    }

    /// What it would normalise `x [1, C, ..]` by.
    pub fn moments(&self, x: &Array) -> GroupMoments {
        // With one sample, a group's channels lie side by side in memory, so that it is one row.
        let rows = x.reshape(&[self.groups, x.len() / self.groups]);
        let group = |i| {
            let row = slice(&rows, 0, i, 1);
            let mean = mean(&row);
            [
                // Mean first and then squares of differences: squares of large numbers would cancel
                // badly.
                mean.into(),
                mean_square(&sub(&row, &row.device().full(row.shape(), mean))).into(),
            ]
        };
        GroupMoments((0..self.groups).map(group).collect())
    }

    /// [`GroupNorm::forward`] of `x [1, C, ..]` by other means and variances than its own: those
    /// only change the scale and the shift of what its own give.
    pub fn forward_by(&self, x: &Array, moments: &GroupMoments) -> Array {
        // The operator normalises by the input's own moments and no others: the difference goes
        // into gamma and beta.
        let own = self.moments(x);
        let eps = f64::from(self.eps);
        let mut gamma = self.gamma.to_vec();
        let mut beta = self.beta.to_vec();
        let channels = gamma.len() / self.groups;
        let groups = gamma.chunks_mut(channels).zip(beta.chunks_mut(channels));
        for ((gamma, beta), ([mean, variance], [wanted_mean, wanted_variance])) in
            groups.zip(own.0.iter().zip(&moments.0))
        {
            // With own mean m and deviation d, wanted m' and d': gamma (x - m') / d' + beta is
            // gamma (d / d') (x - m) / d + beta + gamma (m - m') / d'.
            let deviation = (wanted_variance + eps).sqrt();
            let gain = (variance + eps).sqrt() / deviation;
            let offset = (mean - wanted_mean) / deviation;
            for (gamma, beta) in gamma.iter_mut().zip(beta) {
                // Before gamma changes: the shift is in terms of the old one.
                *beta += *gamma * offset as f32;
                *gamma *= gain as f32;
            }
        }
        let [gamma, beta] =
            [gamma, beta].map(|values| x.device().array(self.gamma.shape(), values));
        group_norm(x, &gamma, &beta, self.groups, self.eps, self.activation)
    }

    /// `x` is the input of the forward pass.
    pub fn backward(&self, x: &Array, dy: &Array) -> Array {
        group_norm_backward(
            x,
            &self.gamma,
            &self.beta,
            self.groups,
            self.eps,
            self.activation,
            dy,
        )
    }
}

/// Mean and variance of each group.
#[derive(Clone, Debug)]
pub(crate) struct GroupMoments(Vec<[f64; 2]>);

impl GroupMoments {
    /// Those of equal parts together.
    pub fn pool(parts: &[Self]) -> Self {
        let count = parts.len() as f64;
        let group = |i: usize| {
            let mean = parts.iter().map(|part| part.0[i][0]).sum::<f64>() / count;
            // The variance of all is the mean of variances plus the variance of means, as parts are
            // equal.
            let spread = |part: &Self| part.0[i][1] + (part.0[i][0] - mean).powi(2);
            [mean, parts.iter().map(spread).sum::<f64>() / count]
        };
        Self(
            (0..parts.first().map_or(0, |part| part.0.len()))
                .map(group)
                .collect(),
        )
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
        Ok(Self {
            gamma: scope.tensor("weight", &[channels])?,
            beta: scope.tensor("bias", &[channels])?,
            eps,
        })
    }

    pub fn forward(&self, x: &Array) -> Array {
        layer_norm(x, &self.gamma, &self.beta, self.eps)
    }

    /// `x` is the input of the forward pass.
    pub fn backward(&self, x: &Array, dy: &Array) -> Array {
        layer_norm_backward(x, &self.gamma, self.eps, dy)
    }
}
