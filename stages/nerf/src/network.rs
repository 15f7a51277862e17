//! The two small networks behind the hash grid: density and colour, forward and backward. Knows
//! rows of samples and the directions that they are seen along, and nothing of where they lie or
//! how they are composited.
//!
//! Matrices are kept as [inputs, outputs], padded with zero columns to whole vectors;
//! [`crate::Field::tensors`] turns them into PyTorch's [outputs, inputs].

use crate::direction_encoding::DirectionEncoding;
use crate::kernels::matrix::{
    COLUMNS, Epilogue, Matrix, Prologue, add_transposed_product, product,
};
use crate::spherical::COEFFICIENTS;
use compute::rng::Rng;
use std::ops::Range;

/// Width of the hidden layers.
pub const HIDDEN: usize = 64;
/// Outputs of the density network: the raw density, and it with 15 more as what the colour network
/// sees.
pub const GEOMETRY: usize = 16;
/// Inputs of the colour network: geometry features and the spherical harmonics of the direction.
pub const COLOR_INPUT: usize = GEOMETRY + COEFFICIENTS;
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

/// The weights as [outputs, inputs], which the backward pass multiplies with.
pub struct Transposed(Vec<f32>);

/// What one pass over a bundle of samples leaves behind. Rows are samples.
#[derive(Default)]
pub struct Activations {
    /// Hash features, and the gradient to them after the backward pass.
    pub encoding: Vec<f32>,
    density_hidden: Vec<f32>,
    /// Outputs of the density network, and the gradient to them after the colour network's backward
    /// pass.
    pub geometry: Vec<f32>,
    directions: DirectionEncoding,
    color_hidden: [Vec<f32>; 2],
    /// Raw colours, before the sigmoid.
    pub color: Vec<f32>,
    d_hidden: [Vec<f32>; 2],
}

impl Activations {
    /// Says which rows are seen along which unit direction. Ranges follow each other.
    pub fn set_directions(&mut self, directions: impl Iterator<Item = ([f32; 3], Range<usize>)>) {
        self.directions.set(directions);
    }
}

impl Transposed {
    /// All matrices, one after the other.
    pub fn values(&self) -> &[f32] {
        &self.0
    }
}

impl Network {
    /// Xavier-uniform weights for an encoding of `features` columns of which `used` are not
    /// padding.
    pub fn new(features: usize, used: usize, seed: u64) -> Self {
        let mut network = Self::zeros(features, used);
        let rng = Rng::new(seed, "network weights");
        for (l, layer) in network.layers.iter().enumerate() {
            // Glorot and Bengio 2010, by the counts without padding.
            let limit = (6.0 / (layer.used[0] + layer.used[1]) as f32).sqrt();
            // Padding stays zero, so that it adds nothing whatever lies in a row's end.
            for row in 0..layer.used[0] {
                for column in 0..layer.used[1] {
                    let at = row * layer.outputs + column;
                    network.weights[layer.offset + at] =
                        limit * (2.0 * rng.uniform(l as u64, at as u64) - 1.0);
                }
            }
        }
        network
    }

    /// A network of the shape that [`Network::new`] gives, with all weights zero.
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
            Layer {
                name,
                inputs,
                outputs,
                used,
                offset,
            }
        });
        Self {
            layers,
            weights: vec![0.0; end],
        }
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

    /// All matrices turned over, as the backward passes want them.
    pub fn transposed(&self) -> Transposed {
        let mut turned = vec![0.0; self.weights.len()];
        for layer in &self.layers {
            for (i, &weight) in self.weights[layer.range()].iter().enumerate() {
                turned[layer.offset + i % layer.outputs * layer.inputs + i / layer.outputs] =
                    weight;
            }
        }
        Transposed(turned)
    }

    fn forward_layer(
        &self,
        l: usize,
        input: &[f32],
        output: &mut Vec<f32>,
        epilogue: Epilogue<'_>,
    ) {
        let layer = &self.layers[l];
        let shape = [layer.inputs, layer.outputs];
        let input = Matrix::new(input, layer.inputs);
        output.resize(input.rows() * layer.outputs, 0.0);
        product(
            output,
            input,
            Matrix::new(self.matrix(l), layer.outputs),
            shape,
            Prologue::Zero,
            epilogue,
        );
    }

    /// The density network: from `encoding` to `geometry`.
    pub fn density(&self, a: &mut Activations) {
        self.forward_layer(0, &a.encoding, &mut a.density_hidden, Epilogue::Relu);
        self.forward_layer(1, &a.density_hidden, &mut a.geometry, Epilogue::Keep);
    }

    /// `geometry`, seen along the directions of [`Activations::set_directions`], to `color`.
    pub fn color(&self, a: &mut Activations) {
        let [first, second] = &mut a.color_hidden;
        let (of_geometry, of_view) = self.matrix(2).split_at(GEOMETRY * HIDDEN);
        let geometry = Matrix::new(&a.geometry, GEOMETRY);
        let of_geometry = Matrix::new(of_geometry, HIDDEN);
        first.resize(geometry.rows() * HIDDEN, 0.0);
        // What the directions give is there first, and the geometry's product is added.
        a.directions.forward(of_view, first);
        product(
            first,
            geometry,
            of_geometry,
            [GEOMETRY, HIDDEN],
            Prologue::Add,
            Epilogue::Relu,
        );
        self.forward_layer(3, first, second, Epilogue::Relu);
        self.forward_layer(4, second, &mut a.color, Epilogue::Keep);
    }

    /// The gradients to a layer's weights (added to `d_weights`) and to its input (written to
    /// `d_input`).
    fn backward_layer(
        &self,
        l: usize,
        transposed: &Transposed,
        [input, d_output]: [&[f32]; 2],
        d_input: &mut Vec<f32>,
        epilogue: Epilogue<'_>,
        d_weights: &mut [f32],
    ) {
        let Layer {
            inputs, outputs, ..
        } = self.layers[l];
        let [input, d_output] = [Matrix::new(input, inputs), Matrix::new(d_output, outputs)];
        add_transposed_product(
            &mut d_weights[self.layers[l].range()],
            input,
            d_output,
            [inputs, outputs],
        );
        self.input_backward(l, transposed, d_output, (d_input, inputs), epilogue);
    }

    /// The gradient to the first `columns` of a layer's input.
    fn input_backward(
        &self,
        l: usize,
        transposed: &Transposed,
        d_output: Matrix<'_>,
        (d_input, columns): (&mut Vec<f32>, usize),
        epilogue: Epilogue<'_>,
    ) {
        let layer = &self.layers[l];
        let turned = Matrix::new(&transposed.0[layer.range()], layer.inputs);
        d_input.resize(d_output.rows() * columns, 0.0);
        product(
            d_input,
            d_output,
            turned,
            // Outputs of padding have no gradient, so that their rows of weights are passed over.
            [layer.used[1], columns],
            Prologue::Zero,
            epilogue,
        );
    }

    /// The backward pass of [`Network::color`]: takes the gradient from `color`, leaves the one to
    /// `geometry` there.
    pub fn color_backward(
        &self,
        transposed: &Transposed,
        a: &mut Activations,
        d_weights: &mut [f32],
    ) {
        let [first, second] = &a.color_hidden;
        let [d_a, d_b] = &mut a.d_hidden;
        let d_color = Matrix::new(&a.color, COLOR_OUTPUT);
        // Three of sixteen columns are used; a full product would mostly add zeros.
        add_narrow_gradient(
            &mut d_weights[self.layers[4].range()],
            Matrix::new(second, HIDDEN),
            d_color,
        );
        self.input_backward(
            4,
            transposed,
            d_color,
            (d_a, HIDDEN),
            Epilogue::ReluBackward(second),
        );
        self.backward_layer(
            3,
            transposed,
            [first, d_a],
            d_b,
            Epilogue::ReluBackward(first),
            d_weights,
        );
        let (of_geometry, of_view) =
            d_weights[self.layers[2].range()].split_at_mut(GEOMETRY * HIDDEN);
        a.directions.backward(d_b, of_view);
        let geometry = Matrix::new(&a.geometry, GEOMETRY);
        let d_first = Matrix::new(d_b, HIDDEN);
        // The weights' gradient comes first: the product below writes over `geometry`.
        add_transposed_product(of_geometry, geometry, d_first, [GEOMETRY, HIDDEN]);
        self.input_backward(
            2,
            transposed,
            d_first,
            (&mut a.geometry, GEOMETRY),
            Epilogue::Keep,
        );
    }

    /// The gradients to the harmonics of every direction that rows were seen along, after
    /// [`Network::color_backward`].
    pub fn harmonics_backward(&self, a: &Activations) -> impl Iterator<Item = [f32; COEFFICIENTS]> {
        let of_view = &self.matrix(2)[GEOMETRY * HIDDEN..];
        a.directions.harmonics_backward(of_view)
    }

    /// The backward pass of [`Network::density`]: takes the gradient from `geometry`, leaves the
    /// one to `encoding` there.
    pub fn density_backward(
        &self,
        transposed: &Transposed,
        a: &mut Activations,
        d_weights: &mut [f32],
    ) {
        let [d_a, d_b] = &mut a.d_hidden;
        let hidden = &a.density_hidden;
        self.backward_layer(
            1,
            transposed,
            [hidden, &a.geometry],
            d_a,
            Epilogue::ReluBackward(hidden),
            d_weights,
        );
        // The product reads the encoding and writes its gradient: they trade places, so that the
        // gradient ends up where the encoding was.
        std::mem::swap(&mut a.encoding, d_b);
        self.backward_layer(
            0,
            transposed,
            [d_b, d_a],
            &mut a.encoding,
            Epilogue::Keep,
            d_weights,
        );
    }
}

/// The gradient to the weights of the last layer. It has so few outputs that vectors run along its
/// inputs: it is summed as [outputs, inputs].
fn add_narrow_gradient(d_weights: &mut [f32], input: Matrix<'_>, d_output: Matrix<'_>) {
    // Three, filled up to the 4 rows of the product's tiles; the fourth's gradient is zero.
    const OUTPUTS: usize = 4;
    let mut turned = [0.0; OUTPUTS * HIDDEN];
    for (i, d) in turned.iter_mut().enumerate() {
        *d = d_weights[i % HIDDEN * COLOR_OUTPUT + i / HIDDEN];
    }
    add_transposed_product(&mut turned, d_output, input, [OUTPUTS, HIDDEN]);
    for (i, d) in turned.iter().enumerate() {
        d_weights[i % HIDDEN * COLOR_OUTPUT + i / HIDDEN] = *d;
    }
}

#[cfg(test)]
mod tests;
