//! The kernels as text: which templates each is made of, and the extents it is compiled for. Knows
//! nothing of buffers.

use super::params::{Cells, Draw, NetworkStep, Outcome, Pass, Span, TableStep, Update};
use crate::network::{Layer, Network};
use compute::kernels::Kernel;

/// Quads of samples that a workgroup works on together.
// 64 samples of 64 rows of 4 bytes are 16 KiB of a workgroup's memory.
const QUADS: u32 = 16;
/// Quads of samples that a workgroup of the backward kernel takes, which holds all their
/// activations.
// 16 samples of 272 rows are 17 KiB; 32 would be more than the 25 KiB that are asked of adapters.
const QUADS_BACKWARD: u32 = 4;
/// Rows of features of the widest layer.
const WIDEST: u32 = 64;

macro_rules! templates {
    ($($name:literal),+) => { &[$(include_str!(concat!("wgsl/", $name, ".wgsl"))),+] };
}

/// All kernels for fields of one shape.
pub struct Programs {
    /// How many samples of each ray are visible.
    pub ray_termination: Kernel<Pass>,
    /// Sums of counts before each.
    pub scan: Kernel<Span>,
    /// Sums of the members of each word before it.
    pub scan_bits: Kernel<Span>,
    /// The samples that are seen.
    pub gather: Kernel<Pass>,
    /// Raw densities and colours.
    pub shade: Kernel<Pass>,
    /// Composites the samples of each ray, front to back.
    pub composite: Kernel<Pass>,
    /// Gradients to raw densities and colours.
    pub composite_backward: Kernel<Pass>,
    /// Gradients to weights and table.
    pub backward: Kernel<Pass>,
    /// What a batch came to.
    pub stats: Kernel<Outcome>,
    /// A step of the networks.
    pub adam_network: Kernel<NetworkStep>,
    /// A step of the table.
    pub adam_table: Kernel<TableStep>,
    /// Random members of a set of cells.
    pub pick: Kernel<Draw>,
    /// Folds fresh optical depths of cells into the grid.
    pub occupancy_update: Kernel<Update>,
    /// From where on a cell is occupied.
    pub threshold: Kernel<Cells>,
    /// The bits of occupied cells.
    pub occupy: Kernel<Cells>,
}

impl Programs {
    /// The kernels for fields with these networks.
    pub fn new(network: &Network) -> Self {
        let shape = constants(&network.layers);
        let count = |body: &str| format!("fn count_of(x: u32) -> u32 {{ return {body}; }}\n");
        let scan = |name, body| Kernel::new(name, templates!["scan"], [1, 1]).having(count(body));
        let forward = [&shape[..], &[("QUADS", QUADS), ("ROWS", WIDEST)]].concat();
        Self {
            ray_termination: Kernel::new(
                "ray_termination",
                templates!["exponential", "rays", "march", "field", "ray_termination"],
                [5, 1],
            )
            .with(&forward),
            scan: scan("scan", "x"),
            scan_bits: scan("scan_bits", "countOneBits(x)"),
            gather: Kernel::new("gather", templates!["rays", "march", "gather"], [4, 2]),
            shade: Kernel::new(
                "shade",
                templates!["harmonics", "rays", "field", "shade"],
                [5, 1],
            )
            .with(&forward),
            composite: Kernel::new("composite", templates!["exponential", "composite"], [2, 2]),
            composite_backward: Kernel::new(
                "composite_backward",
                templates!["exponential", "composite_backward"],
                [6, 2],
            ),
            backward: Kernel::new(
                "backward",
                templates!["harmonics", "rays", "field", "backward"],
                [6, 2],
            )
            .with(&backward(&shape, network.layers[0].inputs as u32)),
            stats: Kernel::new("stats", templates!["stats"], [3, 1]),
            adam_network: Kernel::new("adam_network", templates!["adam", "adam_network"], [2, 2])
                .with(&shape),
            adam_table: Kernel::new("adam_table", templates!["adam", "adam_table"], [2, 6]),
            pick: Kernel::new("pick", templates!["random", "cells", "pick"], [2, 1]),
            occupancy_update: Kernel::new(
                "occupancy_update",
                templates![
                    "exponential",
                    "random",
                    "cells",
                    "field",
                    "occupancy_update"
                ],
                [5, 1],
            )
            .with(&forward),
            threshold: Kernel::new("threshold", templates!["threshold"], [1, 1]),
            occupy: Kernel::new("occupy", templates!["occupy"], [2, 1]),
        }
    }
}

/// Where the matrices lie.
fn constants(layers: &[Layer; 5]) -> Vec<(&'static str, u32)> {
    const NAMES: [[&str; 2]; 5] = [
        ["W0", "T0"],
        ["W1", "T1"],
        ["W2", "T2"],
        ["W3", "T3"],
        ["W4", "T4"],
    ];
    let all: usize = layers
        .iter()
        .map(|layer| layer.inputs * layer.outputs)
        .sum();
    let mut constants = vec![
        ("ENCODING", layers[0].inputs as u32),
        ("WEIGHTS", all as u32),
    ];
    let mut at = 0;
    for ([straight, turned], layer) in NAMES.into_iter().zip(layers) {
        constants.extend([(straight, at as u32), (turned, (all + at) as u32)]);
        at += layer.inputs * layer.outputs;
    }
    constants
}

/// The rows of a tile that holds all activations, from an encoding of so many rows on.
fn backward(shape: &[(&'static str, u32)], encoding: u32) -> Vec<(&'static str, u32)> {
    let mut constants = [shape, &[("QUADS", QUADS_BACKWARD), ("EACH0", encoding / 4)]].concat();
    let mut end = encoding;
    for (name, rows) in [
        ("HIDDEN", 64),
        ("INPUT", 32),
        ("FIRST", 64),
        ("SECOND", 64),
        ("OUT", 16),
    ] {
        // One layer behind the other: nothing is overwritten before its gradient is known.
        constants.push((name, end));
        end += rows;
    }
    constants.push(("ROWS", end));
    constants
}
