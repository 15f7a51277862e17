//! The values of an enum as its JSON Schema tells. Knows no parameter.

use serde_json::Value;

/// One value of an enum.
pub struct Choice<'a> {
    pub name: &'a str,
    /// The schema that documents it.
    pub schema: &'a Value,
    /// What stands in its brackets.
    pub inner: Option<&'a Value>,
}

impl Choice<'_> {
    /// It as a table shows it.
    pub fn words(&self) -> String {
        let brackets = if self.inner.is_some() { "(..)" } else { "" };
        format!("`{}{brackets}`", self.name)
    }
}

/// The values of an enum; `None` for what is none.
pub fn choices(schema: &Value) -> Option<Vec<Choice<'_>>> {
    if let Some(names) = schema["enum"].as_array() {
        return Some(
            names
                .iter()
                .filter_map(|name| plain_choice(name, &Value::Null))
                .collect(),
        );
    }
    Some(schema["oneOf"].as_array()?.iter().flat_map(named).collect())
}

fn plain_choice<'a>(name: &'a Value, schema: &'a Value) -> Option<Choice<'a>> {
    Some(Choice {
        name: name.as_str()?,
        schema,
        inner: None,
    })
}

/// The values of one branch of an enum's schema.
fn named(schema: &Value) -> Vec<Choice<'_>> {
    if let Some(choice) = plain_choice(&schema["const"], schema) {
        return vec![choice];
    }
    let names = schema["enum"].as_array().into_iter().flatten();
    // Values without documentation of their own stand in one list; what it says is said of the
    // enum.
    let plain = names.filter_map(|name| plain_choice(name, &Value::Null));
    let properties = schema["properties"].as_object().into_iter().flatten();
    let variants = properties.map(|(name, inner)| Choice {
        name,
        schema,
        inner: Some(inner),
    });
    plain.chain(variants).collect()
}
