//! A stage kind for tests, small and obedient, and graphs of it: the runner is tested without any
//! real stage.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use artifacts_schema::{Artifact, ArtifactKind, Metrics, Row, SchemaError};
use stages::{Input, InputPort, Io, OutputPort, Port, Stage, StageError};

use crate::pipeline::graph::{Graph, Node, Wire};

/// How often any [`Sum`] of a name ran is counted by its own counter.
pub type Counter = std::sync::Arc<AtomicUsize>;

/// Adds its inputs and a number; writes the sum, reduced by `modulo` so that different inputs can
/// give equal results.
#[derive(Clone)]
pub struct Sum {
    /// What it adds.
    pub number: u32,
    /// What it reduces by.
    pub modulo: u32,
    /// What it does instead of ending well.
    pub act: Act,
    /// How often it ran.
    pub runs: Counter,
    references: Vec<(&'static str, Input)>,
}

/// What a [`Sum`] does.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Act {
    /// It ends well.
    Well,
    Fail,
    /// It has a bug.
    Panic,
    /// It goes on until it is stopped.
    Endless,
    /// The disk is full when it writes its output.
    NoRoom,
    /// It leaves no output.
    Nothing,
}

const INPUTS: [&str; 3] = ["a", "b", "c"];
const SUM: Port<Metrics> = Port::new("sum");

impl Stage for Sum {
    fn kind(&self) -> &'static str {
        "Sum"
    }

    fn version(&self) -> u32 {
        1
    }

    fn check(&self) -> Result<(), StageError> {
        Ok(())
    }

    fn inputs(&self) -> Vec<InputPort<'_>> {
        self.references
            .iter()
            .map(|(name, input)| InputPort::new(name, input, ArtifactKind::Metrics))
            .collect()
    }

    fn outputs(&self) -> Vec<OutputPort> {
        vec![SUM.output()]
    }

    fn run(&self, io: &Io) -> Result<(), StageError> {
        self.runs.fetch_add(1, Ordering::SeqCst);
        let mut sum = f64::from(self.number);
        for folder in io.inputs.values() {
            sum += Metrics::read(folder)?.rows["sum"].mean["value"];
        }
        match self.act {
            Act::Fail => return Err(StageError::Mismatch("these do not fit".into())),
            Act::Panic => panic!("a bug of a test"),
            Act::Endless => loop {
                io.progress(1, 2, &[])?;
                std::thread::sleep(Duration::from_millis(5));
            },
            Act::Nothing => return Ok(()),
            Act::NoRoom => {
                let path = io.outputs.join(SUM.name);
                let source = std::io::ErrorKind::StorageFull.into();
                return Err(StageError::Artifact(SchemaError::Io { path, source }));
            }
            Act::Well => {}
        }
        let mean = BTreeMap::from([("value".to_owned(), sum % f64::from(self.modulo))]);
        let rows = BTreeMap::from([(
            "sum".to_owned(),
            Row {
                mean,
                views: BTreeMap::new(),
            },
        )]);
        io.write(
            SUM,
            &Metrics {
                rows,
                definitions: BTreeMap::new(),
                absent: BTreeMap::new(),
            },
        )
    }
}

/// A node called `name` that reads the nodes at these places.
pub fn sum(name: &str, number: u32, reads: &[usize]) -> (Node, Sum) {
    let references = INPUTS
        .iter()
        .zip(reads)
        .map(|(input, _)| (*input, Input::default()))
        .collect();
    let stage = Sum {
        number,
        modulo: 1000,
        act: Act::Well,
        runs: Counter::default(),
        references,
    };
    (node(name, stage.clone(), reads), stage)
}

/// A node of this stage.
pub fn node(name: &str, stage: Sum, reads: &[usize]) -> Node {
    let wires = INPUTS
        .iter()
        .zip(reads)
        .map(|(input, &from)| Wire {
            input: (*input).to_owned(),
            from,
            output: SUM.name,
        })
        .collect();
    let params = serde_json::json!({"number": stage.number, "modulo": stage.modulo});
    Node {
        name: name.to_owned(),
        also: Vec::new(),
        seed: 0,
        stage: Box::new(stage),
        params,
        wires,
    }
}

/// A graph of these nodes.
pub fn graph(nodes: Vec<Node>) -> Graph {
    Graph::new("test".into(), nodes).unwrap_or_else(|at| panic!("node {at} is on a circle"))
}
