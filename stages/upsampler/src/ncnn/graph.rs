//! A graph that is ready to be computed: layers one after the other, each value forgotten when
//! nothing needs it.

use compute::Array;

use super::layer::Operation;
use crate::network::{Facts, Network};

/// One layer: which values it takes, and which number its own has.
pub struct Step {
    pub operation: Operation,
    pub inputs: Vec<usize>,
}

/// A network. Value 0 is the image, value i + 1 what step i gives; the last one is the result.
pub struct Graph {
    pub steps: Vec<Step>,
    /// For each value, the last step that takes it.
    pub last_use: Vec<Option<usize>>,
    pub facts: Facts,
}

impl Graph {
    /// The network of these steps.
    pub fn new(steps: Vec<Step>, facts: Facts) -> Self {
        let mut last_use = vec![None; steps.len() + 1];
        for (i, step) in steps.iter().enumerate() {
            step.inputs
                .iter()
                // Steps come in order, so the last one to write is the last that reads.
                .for_each(|&input| last_use[input] = Some(i));
        }
        Self {
            steps,
            last_use,
            facts,
        }
    }
}

impl Network for Graph {
    fn forward(&self, x: &Array) -> Array {
        let mut values: Vec<Option<Array>> = vec![Some(x.clone())];
        for (i, step) in self.steps.iter().enumerate() {
            let inputs: Vec<&Array> = step
                .inputs
                .iter()
                .filter_map(|&input| values[input].as_ref())
                .collect();
            let result = step.operation.apply(&inputs);
            // What nobody reads again is freed: memory is that of the widest place.
            for &input in &step.inputs {
                if self.last_use[input] == Some(i) {
                    values[input] = None;
                }
            }
            values.push(Some(result));
        }
        values.pop().flatten().unwrap_or_else(|| x.clone())
    }

    fn facts(&self) -> Facts {
        self.facts.clone()
    }
}
