//! Stages with `shards` replaced by their parts and a merge, before any key is computed: so each
//! part is cached, resumed and distributed like any other stage. The parts of `i3ds.1.render` are
//! `i3ds.1.render.1`, `.2`, ..; the merge keeps the name.

use stages::AnyStage;
use stages::merge::{Merge, Part};

use super::fault::{Fault, FieldPath};
use super::graph::{Graph, Node, Wire};
use super::unroll::seed_within;

/// The same stages, those with shards in parts.
pub fn shard(mut graph: Graph) -> Result<Graph, Fault> {
    let mut nodes = Vec::with_capacity(graph.nodes.len());
    let mut place = Vec::with_capacity(graph.nodes.len());
    for mut node in std::mem::take(&mut graph.nodes) {
        // Stages stand behind those that they read, so these have their new places already.
        node.wires
            .iter_mut()
            .for_each(|wire| wire.from = place[wire.from]);
        let parts = node.stage.shards();
        if parts.is_empty() {
            nodes.push(node);
        } else {
            // Its parts come next, so the first of them will lie at the present end.
            let merge = merge(&node, parts.len(), nodes.len());
            for (number, stage) in (1..).zip(parts) {
                nodes.push(part(&node, number, stage)?);
            }
            nodes.push(merge);
        }
        // Whoever reads the whole reads the merge from now on, which comes last.
        place.push(nodes.len() - 1);
    }
    Ok(Graph { nodes, ..graph })
}

/// One part: it reads what the whole would read, with a seed of its own.
fn part(whole: &Node, number: u32, stage: AnyStage) -> Result<Node, Fault> {
    let name = format!("{}.{number}", whole.name);
    let params = stage
        .parameters()
        .map_err(|error| FieldPath::root("stages").at(&name).fault(error.to_string()))?;
    let seed = seed_within("srnerf-dag shard seed v1", whole.seed, number);
    Ok(Node {
        name,
        also: Vec::new(),
        seed,
        stage: stage.into_stage(),
        params,
        wires: whole.wires.clone(),
    })
}

/// The stage that takes the whole's place, with its parts from place `first` on.
fn merge(whole: &Node, parts: usize, first: usize) -> Node {
    let merge = Merge::new(whole.stage.outputs(), parts);
    let wire = |part: &Part| Wire {
        input: part.input.clone(),
        from: first + part.shard,
        output: part.output.name,
    };
    let wires = merge.parts().iter().map(wire).collect();
    Node {
        name: whole.name.clone(),
        also: Vec::new(),
        // A merge draws no random numbers; with one seed for all, equal merges have equal keys.
        seed: 0,
        params: merge.parameters(),
        stage: Box::new(merge),
        wires,
    }
}
