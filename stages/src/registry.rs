//! Every stage kind there is. A new kind is one file in `kinds` and one line in the list below.

use serde::de::VariantAccess;
use serde::{Deserialize, Serialize};

use crate::stage::Stage;

macro_rules! registry {
    ($($module:ident::$Kind:ident),* $(,)?) => {
        /// A stage of any kind, as it stands in a pipeline file.
        #[derive(Clone, Debug, Serialize, Deserialize)]
        pub enum AnyStage {
            $(
                #[doc = concat!("See [`crate::kinds::", stringify!($module), "`].")]
                $Kind(crate::kinds::$module::$Kind),
            )*
        }

        /// The names of all kinds, in the order of the list.
        pub const KINDS: &[&str] = &[$(stringify!($Kind)),*];

        impl AnyStage {
            /// What all kinds have in common.
            pub fn stage(&self) -> &dyn Stage {
                match self { $(Self::$Kind(stage) => stage),* }
            }

            /// The stage, whatever kind it is of.
            pub fn into_stage(self) -> Box<dyn Stage> {
                match self { $(Self::$Kind(stage) => Box::new(stage)),* }
            }

            /// The JSON Schema of a kind's fields, with defaults and ranges; `None` for a name that
            /// is no kind.
            pub fn schema(kind: &str) -> Option<schemars::Schema> {
                match kind {
                    $(stringify!($Kind) => {
                        Some(schemars::schema_for!(crate::kinds::$module::$Kind))
                    })*
                    _ => None,
                }
            }

            /// The stage itself, with access to its fields as text: what `--set` edits.
            pub fn parameters(&self) -> serde_json::Result<serde_json::Value> {
                match self { $(Self::$Kind(stage) => serde_json::to_value(stage)),* }
            }

            /// The other way: a stage of this kind from fields as text. The error names the field's
            /// path.
            pub fn from_parameters(
                kind: &str,
                value: serde_json::Value,
            ) -> Result<Self, serde_path_to_error::Error<serde_json::Error>> {
                match kind {
                    $(stringify!($Kind) => {
                        serde_path_to_error::deserialize(value).map(Self::$Kind)
                    })*
                    _ => unreachable!("{kind} is in KINDS"),
                }
            }

            /// Reads a stage whose kind (one of [`KINDS`]) has been read already.
            pub fn from_variant<'de, A: VariantAccess<'de>>(
                kind: &str,
                fields: A,
            ) -> Result<Self, A::Error> {
                match kind {
                    $(stringify!($Kind) => fields.newtype_variant().map(Self::$Kind),)*
                    _ => Err(serde::de::Error::unknown_variant(kind, KINDS)),
                }
            }
        }
    };
}

registry! {
    scene::Scene,
    fit::Fit,
    render::Render,
    interpolate::Interpolate,
    blend::Blend,
    encode::Encode,
    optimize::Optimize,
    decode::Decode,
    sync::Sync,
    evaluate::Evaluate,
    film::Film,
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use crate::error::StageError;

    use serde_json::json;

    use super::*;

    #[test]
    fn every_kind_has_defaults_that_make_sense_and_go_through_text() {
        for kind in KINDS {
            let stage = AnyStage::from_parameters(kind, json!({})).unwrap();
            assert_eq!(stage.stage().kind(), *kind);
            assert!(stage.stage().check().is_ok(), "{kind}");
            let parameters = stage.parameters().unwrap();
            let again = AnyStage::from_parameters(kind, parameters.clone()).unwrap();
            assert_eq!(again.parameters().unwrap(), parameters, "{kind}");
        }
    }

    #[test]
    fn inputs_are_fields_and_outputs_have_names_of_their_own() {
        for kind in KINDS {
            let stage = AnyStage::from_parameters(kind, json!({})).unwrap();
            let parameters = stage.parameters().unwrap();
            assert!(
                stage
                    .stage()
                    .inputs()
                    .iter()
                    .all(|port| parameters[port.name].is_string()),
                "{kind}"
            );
            let outputs = stage.stage().outputs();
            let names: BTreeSet<_> = outputs.iter().map(|port| port.name).collect();
            assert!(!names.is_empty() && names.len() == outputs.len(), "{kind}");
        }
    }

    #[test]
    fn a_wrong_field_is_named_by_its_path() {
        let wrong = AnyStage::from_parameters(
            "Optimize",
            json!({ "guidance": { "Vsd": { "lora_every": "often" } } }),
        );
        assert_eq!(
            wrong.err().map(|error| error.path().to_string()).as_deref(),
            Some("guidance.Vsd.lora_every")
        );
    }

    /// What a schema says of a number's range is what `check` says.
    #[test]
    fn documented_ranges_are_those_that_are_checked() {
        let mut tried = 0;
        for kind in KINDS {
            let schema = AnyStage::schema(kind).unwrap().to_value();
            for (field, schema) in schema["properties"].as_object().unwrap() {
                let bound = |name: &str| schema.get(name).and_then(serde_json::Value::as_f64);
                let whole = schema["type"] == "integer";
                // Another field may be refused for it: photos of 192 pixels cannot be reduced 64 times.
                let check = |value: f64| {
                    let value = if whole {
                        json!(value as i64)
                    } else {
                        json!(value)
                    };
                    let stage = AnyStage::from_parameters(kind, json!({ field: value }));
                    let own = format!("`{field}` ");
                    let refused = |error: &StageError| error.to_string().starts_with(&own);
                    stage.is_ok_and(|stage| {
                        !stage.stage().check().err().as_ref().is_some_and(refused)
                    })
                };
                let step = if whole { 1.0 } else { 0.01 };
                if let Some(low) = bound("minimum") {
                    assert!(check(low), "{kind}.{field} may be {low}");
                    assert!(
                        !check(low - step),
                        "{kind}.{field} may not be {low} - {step}"
                    );
                    tried += 1;
                }
                if let Some(low) = bound("exclusiveMinimum") {
                    assert!(
                        !check(low) && check(low + step),
                        "{kind}.{field} is above {low}"
                    );
                    tried += 1;
                }
                if let Some(high) = bound("maximum") {
                    assert!(check(high), "{kind}.{field} may be {high}");
                    assert!(
                        !check(high + step),
                        "{kind}.{field} may not be {high} + {step}"
                    );
                    tried += 1;
                }
            }
        }
        assert!(tried > 40, "{tried} bounds");
    }
}
