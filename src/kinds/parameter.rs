//! A parameter as its JSON Schema tells: path, values, default, meaning. Knows no stage.

use serde_json::Value;

use super::choice::choices;

/// One parameter of a kind, or of a variant.
pub struct Parameter {
    /// Its path from the kind, with dots: `field.levels`.
    pub path: String,
    /// What it may be: `whole number, 1 to 16`.
    pub values: String,
    /// Its default in RON, or that it has none; empty where the table's other rows say it.
    pub default: String,
    /// What the code's documentation says, in one line.
    pub meaning: String,
    /// Its values that have parameters of their own.
    pub variants: Vec<Variant>,
}

/// A value of an enum that has parameters of its own.
pub struct Variant {
    /// The path of the parameter that may have it.
    pub path: String,
    pub name: String,
    /// What the code's documentation says, in one line.
    pub meaning: String,
    /// Its parameters; as `--set` has it, the variant's name is not in their paths.
    pub parameters: Vec<Parameter>,
}

/// The named schemas that a schema refers to.
pub struct Definitions<'a>(Option<&'a Value>);

impl<'a> Definitions<'a> {
    /// Those of a kind's schema.
    pub fn new(schema: &'a Value) -> Self {
        Self(schema.get("$defs"))
    }

    /// The schema itself, where it only refers to a named one or may be `None` as well.
    fn resolve<'b>(&'b self, schema: &'b Value) -> &'b Value {
        // An `Option` of a named type is written as `anyOf: [the type, null]`.
        let mut alternatives = schema["anyOf"].as_array().into_iter().flatten();
        let some = alternatives.find(|schema| schema["type"] != "null");
        if let Some(inner) = some {
            return self.resolve(inner);
        }
        let name = schema["$ref"]
            .as_str()
            .and_then(|path| path.strip_prefix("#/$defs/"));
        match (name, self.0) {
            (Some(name), Some(definitions)) => self.resolve(&definitions[name]),
            _ => schema,
        }
    }

    /// The documentation of a schema in one line.
    pub fn description(&self, schema: &Value) -> String {
        let own = schema["description"].as_str();
        let text = own
            .or_else(|| self.resolve(schema)["description"].as_str())
            .unwrap_or_default();
        text.split_whitespace()
            .collect::<Vec<_>>()
            .join(" ")
            // A bare bar would begin another cell of the table.
            .replace('|', "\\|")
    }

    /// The same of a parameter, with what each plain value of it means.
    fn meaning(&self, schema: &Value) -> String {
        let choices = choices(self.resolve(schema)).unwrap_or_default();
        let plain = choices.iter().filter(|choice| choice.inner.is_none());
        let values = plain.map(|choice| (choice.name, self.description(choice.schema)));
        let own = self.description(schema);
        let documented = values.filter(|(_, text)| !text.is_empty() && *text != own);
        let values = documented.map(|(name, text)| format!(" `{name}`: {text}"));
        own.clone() + &values.collect::<String>()
    }

    /// The parameters of an object, each followed by those that it consists of.
    pub fn parameters(&self, path: &str, object: &Value) -> Vec<Parameter> {
        let object = self.resolve(object);
        let required = |name: &str| {
            let names = object["required"].as_array().into_iter().flatten();
            names.into_iter().any(|required| required == name)
        };
        let properties = object["properties"].as_object().into_iter().flatten();
        properties
            .flat_map(|(name, schema)| {
                let path = match path {
                    "" => name.clone(),
                    path => format!("{path}.{name}"),
                };
                self.parameter(path, schema, required(name))
            })
            .collect()
    }

    fn parameter(&self, path: String, schema: &Value, required: bool) -> Vec<Parameter> {
        let resolved = self.resolve(schema);
        let parts = self.parameters(&path, resolved);
        let default = match schema.get("default") {
            _ if required => "required".into(),
            Some(value) if parts.is_empty() => format!("`{}`", self.ron(value, schema)),
            _ => String::new(),
        };
        let parameter = Parameter {
            values: self.values(schema),
            default,
            meaning: self.meaning(schema),
            variants: self.variants(&path, resolved),
            path,
        };
        std::iter::once(parameter).chain(parts).collect()
    }

    /// What a value may be, in words.
    fn values(&self, schema: &Value) -> String {
        let resolved = self.resolve(schema);
        let words = match (choices(resolved), &resolved["type"]) {
            (Some(choices), _) => choices
                .iter()
                .map(|c| c.words())
                .collect::<Vec<_>>()
                .join(", "),
            (None, kind) if has(kind, "integer") => number("whole number", resolved),
            (None, kind) if has(kind, "number") => number("number", resolved),
            (None, kind) if has(kind, "boolean") => "`true`, `false`".into(),
            (None, kind) if has(kind, "string") => "text".into(),
            (None, kind) if has(kind, "array") => self.tuple(resolved),
            _ => "see below".into(),
        };
        if optional(schema) {
            format!("{words}; or `None`")
        } else {
            words
        }
    }

    fn tuple(&self, schema: &Value) -> String {
        match (
            schema["prefixItems"].as_array(),
            schema["minItems"].as_u64(),
        ) {
            (Some(items), _) => {
                let items: Vec<_> = items.iter().map(|item| self.values(item)).collect();
                format!("({})", items.join(", "))
            }
            (None, Some(count)) => format!("{count} times {}", self.values(&schema["items"])),
            (None, None) => format!("list of {}", self.values(&schema["items"])),
        }
    }

    fn variants(&self, path: &str, schema: &Value) -> Vec<Variant> {
        let choices = choices(schema).unwrap_or_default();
        let with_fields = choices.into_iter().filter_map(|choice| {
            let parameters = self.parameters(path, choice.inner?);
            let meaning = self.description(choice.schema);
            let of_fields = self.description(choice.inner?);
            let meaning = if meaning.is_empty() {
                of_fields
            } else {
                meaning
            };
            let path = path.to_owned();
            Some(Variant {
                path,
                name: choice.name.into(),
                meaning,
                parameters,
            })
        });
        with_fields
            .filter(|variant| !variant.parameters.is_empty())
            .collect()
    }

    /// A value as a pipeline file has it.
    fn ron(&self, value: &Value, schema: &Value) -> String {
        let resolved = self.resolve(schema);
        match value {
            Value::Null => "None".into(),
            Value::String(name) if choices(resolved).is_some() => name.clone(),
            Value::Array(items) => {
                let items: Vec<_> = items
                    .iter()
                    .map(|item| self.ron(item, &Value::Null))
                    .collect();
                format!("({})", items.join(", "))
            }
            Value::Object(fields) => self.record(fields, resolved),
            plain => plain.to_string(),
        }
    }

    /// A struct, or a variant with fields.
    fn record(&self, fields: &serde_json::Map<String, Value>, schema: &Value) -> String {
        let choice = choices(schema).and_then(|choices| {
            choices
                .into_iter()
                // A variant is written as an object whose one key is its name.
                .find(|choice| fields.contains_key(choice.name))
        });
        if let Some((choice, inner)) = choice.and_then(|choice| Some((choice.name, choice.inner?)))
        {
            let value = &fields[choice];
            let inner = self.ron(value, inner);
            // A variant's fields share its parentheses: `Vsd(rate: 1)` and not `Vsd((rate: 1))`.
            return match inner.strip_prefix('(') {
                Some(rest) => format!("{choice}({rest}"),
                None => format!("{choice}({inner})"),
            };
        }
        let property = |name: &String| &self.resolve(schema)["properties"][name];
        let fields = fields
            .iter()
            .map(|(name, value)| format!("{name}: {}", self.ron(value, property(name))));
        format!("({})", fields.collect::<Vec<_>>().join(", "))
    }
}

fn optional(schema: &Value) -> bool {
    // An `Option` is written in two ways: of a named type as `anyOf`, of a plain one as a list of
    // types.
    let alternatives = schema["anyOf"].as_array().into_iter().flatten();
    alternatives
        .into_iter()
        .any(|schema| schema["type"] == "null")
        || {
            schema["type"]
                .as_array()
                .is_some_and(|kinds| kinds.iter().any(|kind| kind == "null"))
        }
}

fn has(kind: &Value, name: &str) -> bool {
    kind == name
        || kind
            .as_array()
            .is_some_and(|kinds| kinds.iter().any(|kind| kind == name))
}

/// `whole number, 1 to 16`.
fn number(what: &str, schema: &Value) -> String {
    let bound = |name: &str| schema.get(name).filter(|bound| bound.as_f64().is_some());
    let low = match (bound("exclusiveMinimum"), bound("minimum")) {
        (Some(low), _) => Some(format!("above {}", plain(low))),
        (None, Some(low)) => Some(plain(low)),
        (None, None) => None,
    };
    let high = match (bound("exclusiveMaximum"), bound("maximum")) {
        (Some(high), _) => Some(format!("below {}", plain(high))),
        (None, Some(high)) => Some(plain(high)),
        (None, None) => None,
    };
    match (low, high) {
        (Some(low), Some(high)) => format!("{what}, {low} to {high}"),
        (Some(low), None) if low.starts_with("above") => format!("{what} {low}"),
        (Some(low), None) => format!("{what} from {low}"),
        (None, Some(high)) => format!("{what} up to {high}"),
        (None, None) => what.into(),
    }
}

/// A bound without `.0`.
fn plain(bound: &Value) -> String {
    match bound.as_f64() {
        Some(number) if number.fract() == 0.0 => format!("{number:.0}"),
        _ => bound.to_string(),
    }
}
