//! What a stage reads: outputs of other stages' results. Knows nothing of where results are kept.

use std::collections::BTreeMap;

use artifacts_schema::Digest;

use crate::pipeline::graph::{Node, Wire};
use crate::store::record::{Output, Record};

/// The digests of a stage's inputs, by input name.
pub type Inputs = BTreeMap<String, Digest>;

/// The outputs that a stage reads, by input name, of those stages that have a result.
pub fn read<'n, 'r>(
    node: &'n Node,
    result: impl Fn(usize) -> Option<&'r Record>,
) -> BTreeMap<&'n str, &'r Output> {
    let output = |wire: &'n Wire| {
        let output = result(wire.from)?.outputs.get(wire.output)?;
        Some((wire.input.as_str(), output))
    };
    node.wires.iter().filter_map(output).collect()
}

/// Their digests.
pub fn digests<'r>(node: &Node, result: impl Fn(usize) -> Option<&'r Record>) -> Inputs {
    let outputs = read(node, result).into_iter();
    outputs
        .map(|(input, output)| (input.to_owned(), output.digest))
        .collect()
}
