//! Where an artifact comes from, as its files tell it.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The file that holds it where the artifact's own files have no room for metadata.
pub(crate) const FILE: &str = "provenance.json";

/// Where an artifact comes from. It goes into the files' metadata as one canonical JSON text, and
/// into no semantic digest: the same result by another way is the same artifact.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Provenance {
    /// The program and its version.
    pub program: String,
    /// The stage's name in its pipeline.
    pub stage: String,
    /// The stage's kind.
    pub kind: String,
    /// The version of the stage's code.
    pub version: String,
    /// The stage's key.
    pub key: String,
    /// The kind of device that computed it: `cpu`, or a GPU's name and driver.
    // Files of older versions have none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub device: String,
    /// The stage's parameters, defaults filled in.
    pub params: serde_json::Value,
    /// The semantic digests of its inputs, by input name.
    pub inputs: BTreeMap<String, String>,
}
