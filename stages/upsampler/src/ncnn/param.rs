//! The text of a `.param` file: layers with the names of what they take and give, and their
//! numbered parameters. Knows the grammar, no layer.

use std::collections::BTreeMap;

use formats::FileBytes;

use crate::error::UpsamplerError;

/// What a text file of ncnn begins with.
const MAGIC: &str = "7767517";
/// Parameters that are lists are numbered from this one down.
const LISTS: i64 = -23300;

/// One layer as it is written.
#[derive(Clone, Debug)]
pub struct Layer {
    pub file: String,
    pub line: usize,
    pub kind: String,
    pub name: String,
    pub inputs: Vec<String>,
    pub outputs: Vec<String>,
    pub parameters: BTreeMap<u32, Vec<f64>>,
}

impl Layer {
    /// An error about this layer.
    pub fn wrong(&self, problem: impl Into<String>) -> UpsamplerError {
        UpsamplerError::Layer {
            file: self.file.clone(),
            line: self.line,
            layer: format!("`{}` ({})", self.name, self.kind),
            problem: problem.into(),
        }
    }
}

/// The layers of a graph, in the order in which they are computed.
pub fn parse(file: &FileBytes) -> Result<Vec<Layer>, UpsamplerError> {
    let wrong = |problem: String| UpsamplerError::file(file.name(), problem);
    // A `.param.bin` is the same graph in bytes, and seldom valid UTF-8.
    let Ok(text) = std::str::from_utf8(file) else {
        return Err(wrong(
            "is no text; ncnn's .param files are read as text, not as .param.bin".to_owned(),
        ));
    };
    let lines = text
        .lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.split_whitespace().collect::<Vec<_>>()));
    let mut lines = lines.filter(|(_, words)| !words.is_empty());
    match lines.next() {
        Some((_, words)) if words == [MAGIC] => (),
        _ => {
            return Err(wrong(format!(
                "does not begin with {MAGIC}, as ncnn's graphs do"
            )));
        }
    }
    let count = match lines.next().as_ref().map(|(_, words)| &words[..]) {
        // The number of blobs is not needed: names tell which blobs there are.
        Some([layers, _]) => layers.parse::<usize>().ok(),
        _ => None,
    };
    let count = count.ok_or_else(|| {
        wrong("line 2: expected are the numbers of layers and of blobs".to_owned())
    })?;
    let layers = lines
        .map(|(line, words)| layer(file, line, &words))
        .collect::<Result<Vec<_>, _>>()?;
    // A shortened file would otherwise be a smaller network.
    if layers.len() != count {
        return Err(wrong(format!(
            "holds {} layers; its second line says {count}",
            layers.len()
        )));
    }
    if layers.is_empty() {
        return Err(wrong("holds no layers".to_owned()));
    }
    Ok(layers)
}

/// One line: kind, name, how many blobs are taken and given, their names, and parameters.
fn layer(file: &FileBytes, line: usize, words: &[&str]) -> Result<Layer, UpsamplerError> {
    let wrong =
        |problem: String| UpsamplerError::file(file.name(), format!("line {line}: {problem}"));
    let &[kind, name, inputs, outputs, ref rest @ ..] = words else {
        return Err(wrong(
            "expected are a layer's kind, name, and numbers of inputs and outputs".to_owned(),
        ));
    };
    let [inputs, outputs] = [inputs, outputs].map(str::parse::<usize>);
    let (Ok(inputs), Ok(outputs)) = (inputs, outputs) else {
        return Err(wrong(format!(
            "layer `{name}`: the numbers of inputs and outputs are no numbers"
        )));
    };
    // Both counts are the file's own, so their sum may overflow and the line may be too short.
    let Some((blobs, parameters)) = inputs
        .checked_add(outputs)
        .and_then(|count| rest.split_at_checked(count))
    else {
        return Err(wrong(format!(
            "layer `{name}` names fewer blobs than {inputs} and {outputs}"
        )));
    };
    let names = |blobs: &[&str]| {
        blobs
            .iter()
            .map(|&name| name.to_owned())
            .collect::<Vec<_>>()
    };
    let mut layer = Layer {
        file: file.name().to_owned(),
        line,
        kind: kind.to_owned(),
        name: name.to_owned(),
        inputs: names(&blobs[..inputs]),
        outputs: names(&blobs[inputs..]),
        parameters: BTreeMap::new(),
    };
    for &word in parameters {
        let Some((number, values)) = parameter(word) else {
            return Err(layer.wrong(format!(
                "has the parameter {word:?}; expected is number=value"
            )));
        };
        if layer.parameters.insert(number, values).is_some() {
            return Err(layer.wrong(format!("gives the parameter {number} twice")));
        }
    }
    Ok(layer)
}

/// `3=1`, or `-23303=2,0.5,1.0` for a list.
fn parameter(word: &str) -> Option<(u32, Vec<f64>)> {
    let (number, text) = word.split_once('=')?;
    // A list has the number -23300 - n, and its length stands before its values.
    let number: i64 = number.parse().ok()?;
    let values = text
        .split(',')
        .map(str::parse::<f64>)
        .collect::<Result<Vec<_>, _>>()
        .ok()?;
    // Rust's parser takes `inf` and `NaN`, which no parameter may be.
    let finite = values.iter().all(|value| value.is_finite());
    match (&values[..], number) {
        _ if !finite => None,
        ([_], 0..) => Some((u32::try_from(number).ok()?, values)),
        ([count, rest @ ..], _) if number <= LISTS && *count == rest.len() as f64 => {
            Some((u32::try_from(LISTS - number).ok()?, rest.to_vec()))
        }
        _ => None,
    }
}
