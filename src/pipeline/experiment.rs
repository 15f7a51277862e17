//! What a pipeline compares: arms, and the seeds that each is run with. Plain data, kept with each
//! run. Knows no stages.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// The arms of a pipeline.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Experiment {
    /// The arms in the order of the file.
    pub arms: Vec<Arm>,
    /// The name of the arm that others are compared with.
    pub baseline: String,
    /// The name of the arm that is the best that can be hoped for, if there is one.
    pub bound: Option<String>,
    /// The seeds that each arm is run with; none where the pipeline's own is the only one.
    pub seeds: Vec<u64>,
    /// The row of metrics that arms are compared by.
    pub row: String,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Arm {
    pub name: String,
    /// The values in which it differs from the pipeline's own, in RON, by the paths of `--set`.
    pub differences: BTreeMap<String, String>,
}

impl Experiment {
    /// The folders of an arm's results under the pipeline's own, one for each seed: `ours`, or
    /// `ours/seed_1`.
    pub fn folders(&self, arm: &str) -> Vec<String> {
        match self.seeds[..] {
            [] => vec![arm.to_owned()],
            _ => self
                .seeds
                .iter()
                .map(|seed| format!("{arm}/seed_{seed}"))
                .collect(),
        }
    }

    /// So many of its arms in words: `7 arms x 3 seeds`.
    pub fn size(&self, arms: usize) -> String {
        let arms = format!("{arms} {}", if arms == 1 { "arm" } else { "arms" });
        match self.seeds.len() {
            0 | 1 => arms,
            seeds => format!("{arms} x {seeds} seeds"),
        }
    }
}

/// The arm of a stage of an experiment: `ours` of `ours/seed_1/fit`.
pub fn arm_of(stage: &str) -> Option<&str> {
    stage.split_once('/').map(|(arm, _)| arm)
}
