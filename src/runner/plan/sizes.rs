//! How large the inputs of stages are: of results by their files, of what has yet to be computed as
//! the stages upstream foretell it. Knows nothing of memory and time.

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::{ArtifactKind, image_stream, latent_stream};
use stages::{Foretold, Size, Sizes};

use super::{Context, inputs};
use crate::pipeline::graph::{Node, Wire};
use crate::store::Store;
use crate::store::record::{Output, Record, StoredFile};

/// The sizes of the inputs of a stage whose inputs are all there.
pub fn of_results<'n, 'r>(
    store: &Store,
    node: &'n Node,
    result: impl Fn(usize) -> Option<&'r Record>,
) -> Sizes<'n> {
    let outputs = inputs::read(node, result).into_iter();
    outputs
        .map(|(input, output)| (input, of_output(store, output)))
        .collect()
}

/// The size of an output. Of one whose files are not here, as in a remote, only the bytes are known.
fn of_output(store: &Store, output: &Output) -> Size {
    let bytes = output.files.iter().map(|file| file.bytes).sum();
    match output.kind {
        ArtifactKind::Images => of_images(store, output, bytes),
        ArtifactKind::Latents | ArtifactKind::Residuals => {
            // All of them are in one file.
            let mut files = output.files.iter();
            let sizes =
                |file: &StoredFile| latent_stream::sizes(&store.blobs.path(&file.blob)).ok();
            Size::of_latents(files.next().and_then(sizes), bytes)
        }
        _ => Size::of_bytes(bytes),
    }
}

fn of_images(store: &Store, output: &Output, bytes: u64) -> Size {
    let page = output
        .files
        .iter()
        .find(|file| file.path == image_stream::PAGE);
    match page.and_then(|page| image_stream::sizes(&store.blobs.path(&page.blob)).ok()) {
        Some(sizes) => Size::of_images(sizes, Some(bytes)),
        // As many pixels as there are, if files were not compressed.
        None => Size {
            pixels: bytes / 6,
            largest: bytes / 6,
            ..Size::of_bytes(bytes)
        },
    }
}

/// The sizes of what stages read that have yet to run.
pub struct Expected {
    /// By stage and output.
    outputs: BTreeMap<usize, BTreeMap<String, Size>>,
}

impl Context<'_> {
    /// What the stages `missing` will read, given the results that there are.
    pub fn expected<'r>(
        &self,
        missing: &[usize],
        record: impl Fn(usize) -> Option<&'r Record>,
    ) -> Expected {
        let nodes = &self.graph.nodes;
        let wires = missing.iter().flat_map(|&at| &nodes[at].wires);
        let read: BTreeSet<usize> = wires.map(|wire| wire.from).collect();
        let mut expected = Expected {
            outputs: BTreeMap::new(),
        };
        // In the order of stages, in which each comes after those that it reads.
        for at in read {
            let sizes = match record(at) {
                Some(record) => {
                    let outputs = record.outputs.iter();
                    outputs
                        .map(|(name, output)| (name.clone(), of_output(self.store, output)))
                        .collect()
                }
                None => {
                    let node = &nodes[at];
                    named(node.stage.foretell(&expected.of_inputs(node)))
                }
            };
            expected.outputs.insert(at, sizes);
        }
        expected
    }
}

impl Expected {
    /// The sizes of a stage's inputs.
    pub fn of_inputs<'n>(&self, node: &'n Node) -> Sizes<'n> {
        let size = |wire: &'n Wire| {
            let size = self.outputs.get(&wire.from)?.get(wire.output)?;
            Some((wire.input.as_str(), *size))
        };
        node.wires.iter().filter_map(size).collect()
    }
}

fn named(sizes: Foretold) -> BTreeMap<String, Size> {
    let sizes = sizes.into_iter();
    sizes.map(|(name, size)| (name.to_owned(), size)).collect()
}
