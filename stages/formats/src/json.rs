//! JSON in one form only: sorted keys, shortest numbers that read back exactly. What is told apart
//! by its bytes can be written so. And what a value is, in words.

use serde::Serialize;
use serde_json::{Error, Value};

/// The one JSON value of `content`, keys sorted.
///
/// # Errors
/// What has no form in JSON.
pub fn value(content: &impl Serialize) -> Result<Value, Error> {
    let mut value = serde_json::to_value(content)?;
    // Structs write fields in the order of their declaration, which may change.
    value.sort_all_objects();
    Ok(value)
}

/// The one JSON text of `content`, on one line, in ASCII.
///
/// # Errors
/// What has no form in JSON.
pub fn line(content: &impl Serialize) -> Result<String, Error> {
    let mut line = String::new();
    // In ASCII, since OpenEXR's and PNG's texts are not UTF-8.
    for character in value(content)?.to_string().chars() {
        // Only strings hold other characters, and there an escape means the same.
        match character.is_ascii() {
            true => line.push(character),
            false => line.extend(
                character
                    .encode_utf16(&mut [0; 2])
                    .iter()
                    .map(|unit| format!("\\u{unit:04x}")),
            ),
        }
    }
    Ok(line)
}

/// The one JSON text of `content`, indented for people.
///
/// # Errors
/// What has no form in JSON.
pub fn page(content: &impl Serialize) -> Result<String, Error> {
    Ok(format!("{:#}\n", value(content)?))
}

/// What a value is, for people.
pub fn kind(value: &Value) -> String {
    match value {
        Value::Null => "null".into(),
        Value::Bool(value) => value.to_string(),
        Value::Number(value) => value.to_string(),
        // Long texts would fill the message; their kind is enough.
        Value::String(text) if text.chars().count() <= 40 => format!("{text:?}"),
        Value::String(_) => "a long text".into(),
        Value::Array(_) => "a list".into(),
        Value::Object(_) => "an object".into(),
    }
}
