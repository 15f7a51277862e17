//! The reference of all stage kinds as Markdown: what a pipeline file may say, by what the code
//! says of itself. Knows JSON Schemas, and no stage by name.

mod choice;
mod parameter;

use std::fmt::Write;

use serde_json::Value;
use stages::{AnyStage, KINDS};

use parameter::{Definitions, Parameter, Variant};

/// The page's beginning.
const HEAD: &str = "# Stage kinds

Every kind that a pipeline file may name, with its inputs, outputs and parameters. This page is what
`srnerf-dag kinds --all` prints; a test fails where the two differ. `srnerf-dag kinds KIND` prints one
part of it, and `--json` the same as JSON Schema.

A parameter of a parameter is written with a dot, as `--set` takes it. Where a value is a variant with
parameters of its own, such as `Vsd(..)`, they stand in a table below.
";

pub fn page() -> String {
    let mut page = String::from(HEAD);
    for kind in KINDS {
        page.push('\n');
        page.push_str(&section(kind));
    }
    page
}

/// The part of one kind, which must be one of [`KINDS`].
pub fn section(kind: &str) -> String {
    let schema = schema(kind);
    let definitions = Definitions::new(&schema);
    let mut text = format!("## {kind}\n\n{}\n\n", definitions.description(&schema));
    // With all parameters at their defaults: ports are told by stages, not by schemas.
    let stage = AnyStage::from_parameters(kind, Value::Object(Default::default())).ok();
    let stage = stage.as_ref().map(AnyStage::stage);
    let outputs = stage.map_or(Vec::new(), |stage| stage.outputs());
    let outputs: Vec<String> = outputs
        .iter()
        .map(|port| format!("`{}` ({})", port.name, port.kind))
        .collect();
    // Writing to a string cannot fail.
    _ = writeln!(text, "Writes {}.\n", outputs.join(", "));
    let inputs = stage.map_or(Vec::new(), |stage| stage.inputs());
    let parameters = definitions.parameters("", &schema);
    text.push_str(&table(&parameters, |parameter| {
        let input = inputs.iter().find(|port| port.name == parameter.path);
        input.map(|port| format!("reference to {}", port.kind))
    }));
    text + &variants(&parameters)
}

/// A table for each value that has parameters of its own, and for theirs.
fn variants(parameters: &[Parameter]) -> String {
    let variants = parameters.iter().flat_map(|parameter| &parameter.variants);
    let one = |variant: &Variant| {
        let Variant {
            path,
            name,
            meaning,
            parameters,
        } = variant;
        let rows = table(parameters, |_| None);
        format!(
            "\n`{path}: {name}(..)`: {meaning}\n\n{rows}{}",
            self::variants(parameters)
        )
    };
    variants.map(one).collect()
}

/// The JSON Schema of a kind, or of all kinds by name.
pub fn schema(kind: &str) -> Value {
    AnyStage::schema(kind).map_or(Value::Null, Value::from)
}

/// A row for each parameter; `input` says what an input refers to.
fn table(parameters: &[Parameter], input: impl Fn(&Parameter) -> Option<String>) -> String {
    let mut text = String::from("| parameter | values | default | meaning |\n|---|---|---|---|\n");
    for parameter in parameters {
        let values = input(parameter);
        let default = if values.is_some() {
            ""
        } else {
            &parameter.default
        };
        _ = writeln!(
            text,
            "| `{}` | {} | {} | {} |",
            parameter.path,
            values.as_ref().unwrap_or(&parameter.values),
            default,
            parameter.meaning
        );
    }
    text
}
