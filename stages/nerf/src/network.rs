//! The two small networks behind the hash grid: density and colour, forward and backward. Knows rows of samples, and
//! nothing of where they lie or how they are composited.
//!
//! Matrices are kept as [inputs, outputs], padded with zero columns to whole vectors; [`crate::Field::tensors`] turns
//! them into PyTorch's [outputs, inputs].

use crate::kernels::matrix::{COLUMNS, Epilogue, add_transposed_product, product};
use compute::rng::Rng;

/// Width of the hidden layers.
pub const HIDDEN: usize = 64;
/// Outputs of the density network: the raw density, and it with 15 more as what the colour network sees.
pub const GEOMETRY: usize = 16;
/// Inputs of the colour network: geometry features and the spherical harmonics of the direction.
pub const COLOR_INPUT: usize = GEOMETRY + crate::spherical::COEFFICIENTS;
/// Outputs of the colour network in memory; the first three are red, green and blue.
pub const COLOR_OUTPUT: usize = COLUMNS;

/// One matrix of the network, without a bias.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Its name among a field's tensors.
    pub name: &'static str,
    /// Columns of the input in memory, and rows of the matrix.
    pub inputs: usize,
    /// Columns of the output in memory.
    pub outputs: usize,
    /// Inputs and outputs that are not padding.
    pub used: [usize; 2],
    offset: usize,
}

impl Layer {
    fn range(&self) -> std::ops::Range<usize> {
        self.offset..self.offset + self.inputs * self.outputs
    }
}

/// The weights of both networks.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Density (2 layers), then colour (3 layers).
    pub layers: [Layer; 5],
    /// All matrices, one after the other; also the layout of gradients.
    pub weights: Vec<f32>,
}

/// The same weights as [outputs, inputs], which the backward pass multiplies with.
pub struct Transposed(Vec<f32>);

/// What one pass over a block of samples leaves behind. Rows are samples.
#[derive(Default)]
pub struct Activations {
    /// Hash features, and the gradient to them after the backward pass.
    pub encoding: Vec<f32>,
    density_hidden: Vec<f32>,
    /// Outputs of the density network.
    pub geometry: Vec<f32>,
    /// Inputs of the colour network.
    pub color_input: Vec<f32>,
    color_hidden: [Vec<f32>; 2],
    /// Raw colours, before the sigmoid.
    pub color: Vec<f32>,
    d_hidden: [Vec<f32>; 2],
}

impl Transposed {
    /// All matrices, one after the other.
    pub fn values(&self) -> &[f32] {
        &self.0
    }
}

impl Network {
    /// Xavier-uniform weights for an encoding of `features` columns of which `used` are not padding.
    pub fn new(features: usize, used: usize, seed: u64) -> Self {
        let mut network = Self::zeros(features, used);
        let rng = Rng::new(seed, "network weights");
        for (l, layer) in network.layers.iter().enumerate() {
            let limit = (6.0 / (layer.used[0] + layer.used[1]) as f32).sqrt();
            for row in 0..layer.used[0] {
                for column in 0..layer.used[1] {
                    let at = row * layer.outputs + column;
                    network.weights[layer.offset + at] = limit * (2.0 * rng.uniform(l as u64, at as u64) - 1.0);
                }
            }
        }
        network
    }

    /// The same shape with all weights zero.
    pub fn zeros(features: usize, used: usize) -> Self {
        let shapes = [
            ("density.0.weight", features, HIDDEN, [used, HIDDEN]),
            ("density.1.weight", HIDDEN, GEOMETRY, [HIDDEN, GEOMETRY]),
            ("color.0.weight", COLOR_INPUT, HIDDEN, [COLOR_INPUT, HIDDEN]),
            ("color.1.weight", HIDDEN, HIDDEN, [HIDDEN, HIDDEN]),
            ("color.2.weight", HIDDEN, COLOR_OUTPUT, [HIDDEN, 3]),
        ];
        let mut end = 0;
        let layers = shapes.map(|(name, inputs, outputs, used)| {
            let offset = end;
            end += inputs * outputs;
            Layer { name, inputs, outputs, used, offset }
        });
        Self { layers, weights: vec![0.0; end] }
    }

    /// The matrix of layer `l`, [inputs, outputs].
    pub fn matrix(&self, l: usize) -> &[f32] {
        &self.weights[self.layers[l].range()]
    }

    /// The matrix of layer `l`, to be changed; padding stays zero.
    pub fn matrix_mut(&mut self, l: usize) -> &mut [f32] {
        let range = self.layers[l].range();
        &mut self.weights[range]
    }

    /// All matrices turned over, as [`Network::backward`] wants them.
    pub fn transposed(&self) -> Transposed {
        let mut turned = vec![0.0; self.weights.len()];
        for layer in &self.layers {
            for (i, &weight) in self.weights[layer.range()].iter().enumerate() {
                turned[layer.offset + i % layer.outputs * layer.inputs + i / layer.outputs] = weight;
            }
        }
        Transposed(turned)
    }

    fn forward_layer(&self, l: usize, input: &[f32], output: &mut Vec<f32>, epilogue: Epilogue<'_>) {
        let layer = &self.layers[l];
        output.resize(input.len() / layer.inputs * layer.outputs, 0.0);
        product(output, input, self.matrix(l), layer.inputs, layer.outputs, epilogue);
    }

    /// `encoding` to `geometry`.
    pub fn density(&self, a: &mut Activations) {
        self.forward_layer(0, &a.encoding, &mut a.density_hidden, Epilogue::Relu);
        self.forward_layer(1, &a.density_hidden, &mut a.geometry, Epilogue::Keep);
    }

    /// `color_input` to `color`.
    pub fn color(&self, a: &mut Activations) {
        let [first, second] = &mut a.color_hidden;
        self.forward_layer(2, &a.color_input, first, Epilogue::Relu);
        self.forward_layer(3, first, second, Epilogue::Relu);
        self.forward_layer(4, second, &mut a.color, Epilogue::Keep);
    }

    /// The gradients to a layer's weights (added to `d_weights`) and to its input (written to `d_input`).
    fn backward_layer(
        &self,
        l: usize,
        transposed: &Transposed,
        [input, d_output]: [&[f32]; 2],
        d_input: &mut Vec<f32>,
        epilogue: Epilogue<'_>,
        d_weights: &mut [f32],
    ) {
        let layer = &self.layers[l];
        add_transposed_product(&mut d_weights[layer.range()], input, d_output, layer.inputs, layer.outputs);
        d_input.resize(input.len(), 0.0);
        product(d_input, d_output, &transposed.0[layer.range()], layer.outputs, layer.inputs, epilogue);
    }

    /// The backward pass of [`Network::color`]: takes the gradient from `color`, leaves the one to `color_input` there.
    pub fn color_backward(&self, transposed: &Transposed, a: &mut Activations, d_weights: &mut [f32]) {
        let [first, second] = &a.color_hidden;
        let [d_a, d_b] = &mut a.d_hidden;
        self.backward_layer(4, transposed, [second, &a.color], d_a, Epilogue::ReluBackward(second), d_weights);
        self.backward_layer(3, transposed, [first, d_a], d_b, Epilogue::ReluBackward(first), d_weights);
        std::mem::swap(&mut a.color_input, d_a);
        self.backward_layer(2, transposed, [d_a, d_b], &mut a.color_input, Epilogue::Keep, d_weights);
    }

    /// The backward pass of [`Network::density`]: takes the gradient from `geometry`, leaves the one to `encoding`
    /// there.
    pub fn density_backward(&self, transposed: &Transposed, a: &mut Activations, d_weights: &mut [f32]) {
        let [d_a, d_b] = &mut a.d_hidden;
        let hidden = &a.density_hidden;
        self.backward_layer(1, transposed, [hidden, &a.geometry], d_a, Epilogue::ReluBackward(hidden), d_weights);
        std::mem::swap(&mut a.encoding, d_b);
        self.backward_layer(0, transposed, [d_b, d_a], &mut a.encoding, Epilogue::Keep, d_weights);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: usize = 16;

    fn random(len: usize, step: u64) -> Vec<f32> {
        let rng = Rng::new(9, "network test");
        (0..len as u64).map(|i| rng.normal(step, i)).collect()
    }

    /// A linear functional of both networks' outputs.
    fn loss(network: &Network, a: &mut Activations, c: &[f32], g: &[f32]) -> f64 {
        network.density(a);
        network.color(a);
        let dot = |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum::<f64>();
        dot(&a.color, c) + dot(&a.geometry, g)
    }

    #[test]
    fn gradients_match_finite_differences() {
        let network = Network::new(32, 32, 5);
        let (c, g) = (random(ROWS * COLOR_OUTPUT, 0), random(ROWS * GEOMETRY, 1));
        let (encoding, color_input) = (random(ROWS * 32, 2), random(ROWS * COLOR_INPUT, 3));
        let fresh =
            || Activations { encoding: encoding.clone(), color_input: color_input.clone(), ..Default::default() };
        let mut a = fresh();
        loss(&network, &mut a, &c, &g);
        let (mut d_weights, turned) = (vec![0.0; network.weights.len()], network.transposed());
        (a.color, a.geometry) = (c.clone(), g.clone());
        network.color_backward(&turned, &mut a, &mut d_weights);
        network.density_backward(&turned, &mut a, &mut d_weights);

        // A difference that carries a unit across the kink of its ReLU is wrong; few do.
        let (mut checked, mut wrong) = (0, 0);
        let mut check = |analytic: f32, difference: f64| {
            let numeric = difference / 1e-3;
            checked += 1;
            wrong += usize::from((numeric - f64::from(analytic)).abs() > 0.02 * (1.0 + numeric.abs()));
        };
        for at in (0..network.weights.len()).step_by(97) {
            let at_shift = |shift| {
                let mut moved = network.clone();
                moved.weights[at] += shift;
                loss(&moved, &mut fresh(), &c, &g)
            };
            check(d_weights[at], at_shift(5e-4) - at_shift(-5e-4));
        }
        for at in (0..ROWS * 32).step_by(31) {
            let at_shift = |shift, color: bool| {
                let mut moved = fresh();
                if color {
                    moved.color_input[at] += shift
                } else {
                    moved.encoding[at] += shift
                }
                loss(&network, &mut moved, &c, &g)
            };
            check(a.encoding[at], at_shift(5e-4, false) - at_shift(-5e-4, false));
            check(a.color_input[at], at_shift(5e-4, true) - at_shift(-5e-4, true));
        }
        assert!(wrong * 10 < checked, "{wrong} of {checked} gradients are wrong");
    }
}
