//! JSON Schemas of all JSON that artifacts hold, made from the types that read and write it.

use schemars::{Schema, schema_for};

use crate::field::FieldMetadata;
use crate::latents::LatentsMetadata;
use crate::log::LogLine;
use crate::lora::LoraMetadata;
use crate::metrics::MetricsFile;
use crate::provenance::Provenance;
use crate::transforms::Transforms;

/// The schemas by name; the crate's folder `schemas` holds each as `<name>.json`.
pub fn all() -> Vec<(&'static str, Schema)> {
    vec![
        ("field", schema_for!(FieldMetadata)),
        ("latents", schema_for!(LatentsMetadata)),
        ("log", schema_for!(LogLine)),
        ("lora", schema_for!(LoraMetadata)),
        ("metrics", schema_for!(MetricsFile)),
        ("provenance", schema_for!(Provenance)),
        ("transforms", schema_for!(Transforms)),
    ]
}
