//! The graphs of several arms as one, in which a stage that they share stands once. Two stages are
//! the same if they are of one kind with the same parameters and seed, and read the same outputs of
//! the same stages. Knows nothing of keys: stages that come to the same key in another way find
//! each other's results in the store.

use std::collections::BTreeMap;

use super::graph::{Graph, Node};

/// A graph that others are added to.
pub struct Merge {
    graph: Graph,
    /// Where a stage of this identity stands.
    places: BTreeMap<String, usize>,
}

impl Merge {
    /// Before the first arm.
    pub fn new(pipeline: String) -> Self {
        let graph = Graph {
            pipeline,
            nodes: Vec::new(),
            experiment: None,
        };
        Self {
            graph,
            places: BTreeMap::new(),
        }
    }

    /// Adds an arm's stages, whose names begin with that of its folder.
    pub fn add(&mut self, folder: &str, arm: Graph) {
        let mut place_of: Vec<usize> = Vec::with_capacity(arm.nodes.len());
        for mut node in arm.nodes {
            // Stages stand behind those that they read, so these have their new places already.
            for wire in &mut node.wires {
                wire.from = place_of[wire.from];
            }
            node.name = format!("{folder}/{}", node.name);
            place_of.push(self.place(node));
        }
    }

    fn place(&mut self, node: Node) -> usize {
        let nodes = &mut self.graph.nodes;
        let at = *self.places.entry(identity(&node)).or_insert(nodes.len());
        match nodes.get_mut(at) {
            // It keeps the name of the arm that came first, and is shown under all of them.
            Some(same) => same.also.push(node.name),
            None => nodes.push(node),
        }
        at
    }

    /// The graph of all arms.
    pub fn finish(self) -> Graph {
        self.graph
    }
}

/// Everything that tells a stage from others of the same pipeline.
fn identity(node: &Node) -> String {
    let mut params = node.params.clone();
    // What an input refers to, the wires say; in two arms the same reference can mean different
    // stages.
    if let Some(fields) = params.as_object_mut() {
        for port in node.stage.inputs() {
            fields.remove(port.name);
        }
    }
    let wires = node
        .wires
        .iter()
        .map(|wire| format!("{}={}.{}", wire.input, wire.from, wire.output));
    let wires = wires.collect::<Vec<_>>().join(",");
    format!("{} {} {params} {wires}", node.stage.kind(), node.seed)
}
