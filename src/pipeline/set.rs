//! One value of a pipeline overridden: by `--set path=value`, or by a `"path": value` in a file.
//! Knows nothing of what else stands in files.

use std::ops::Range;

use serde_json::Value as Json;
use stages::registry::AnyStage;

use super::fault::FieldPath;
use super::grammar::{Named, Pipeline, Rounds, StageOrLoop};
use super::problem::{Problem, SourceText};
use super::text::{Entry, Tree};

/// One value to override, and where.
#[derive(Clone, Debug)]
pub struct Override {
    /// The argument or file that it stands in.
    pub source: SourceText,
    path: Vec<Segment>,
    path_span: Range<usize>,
    value: Json,
    /// Where in it the value stands.
    pub value_span: Range<usize>,
}

#[derive(Clone, Debug)]
struct Segment {
    name: String,
    span: Range<usize>,
}

impl Override {
    /// Reads `path=value`, the value in RON.
    pub fn read(argument: &str) -> Result<Self, Problem> {
        let source = SourceText {
            name: SourceText::SET.into(),
            text: argument.into(),
        };
        // At the first `=`: no path has one, and a value can.
        let Some((path, value)) = argument.split_once('=') else {
            let problem = source.problem(0..argument.len(), "expected `path=value`");
            return Err(problem.with_help("for example --set scene.downscale=2"));
        };
        let value_span = path.len() + 1..argument.len();
        let tree = Tree::read(value).map_err(|garbled| {
            let at = value_span.start + garbled.at;
            let problem = source.problem(
                at..at + 1,
                format!("the value is not RON: expected {}", garbled.expected),
            );
            problem.with_help("texts stand in quotes: --set 'scene.source.path=\"photos/fern\"'")
        })?;
        Ok(Self {
            path: segments(path, 0),
            path_span: 0..path.len(),
            value: tree.json(),
            value_span,
            source,
        })
    }

    /// A `"path": value` of a file.
    pub fn of_entry(source: &SourceText, entry: &Entry) -> Self {
        // Names stand in quotes there, and their span begins at the first of these.
        let inside_quotes = entry.span.start + 1;
        Self {
            path: segments(&entry.name, inside_quotes),
            path_span: entry.span.clone(),
            value: entry.tree.json(),
            value_span: entry.tree.span.clone(),
            source: source.clone(),
        }
    }

    /// Its path as written: `i3ds.optimize.steps`.
    pub fn path(&self) -> String {
        let names: Vec<&str> = self.path.iter().map(|step| step.name.as_str()).collect();
        names.join(".")
    }

    /// Its value as written, on one line.
    pub fn value_text(&self) -> String {
        let text = self.source.text.get(self.value_span.clone());
        let words: Vec<&str> = text.unwrap_or_default().split_whitespace().collect();
        words.join(" ")
    }

    /// Its value as serde writes it.
    pub fn value(&self) -> &Json {
        &self.value
    }

    /// Overrides the value, and says at which place of the pipeline.
    pub fn apply(&self, pipeline: &mut Pipeline) -> Result<FieldPath, Problem> {
        let (first, rest) = self.split(&self.path)?;
        match first.name.as_str() {
            "seed" if rest.is_empty() => pipeline.seed = self.typed()?,
            "name" if rest.is_empty() => pipeline.name = self.typed()?,
            _ => {
                return self.in_stages(
                    &mut pipeline.stages,
                    &self.path,
                    FieldPath::root("stages"),
                    &["seed", "name"],
                );
            }
        }
        Ok(FieldPath::root(&first.name))
    }

    fn split<'s>(&self, path: &'s [Segment]) -> Result<(&'s Segment, &'s [Segment]), Problem> {
        path.split_first().ok_or_else(|| {
            let problem = self
                .source
                .problem(self.path_span.clone(), "this names no single value");
            problem.with_help("go on to one of its fields: stage.field=value")
        })
    }

    fn in_stages(
        &self,
        stages: &mut Named<StageOrLoop>,
        path: &[Segment],
        place: FieldPath,
        others: &[&str],
    ) -> Result<FieldPath, Problem> {
        let (head, rest) = self.split(path)?;
        // Copied, since the stages are borrowed to be changed from here on.
        let known: Vec<String> = stages
            .names()
            .chain(others.iter().copied())
            .map(str::to_owned)
            .collect();
        let Some(node) = stages.get_mut(&head.name) else {
            let problem = self.source.problem(
                head.span.clone(),
                format!("there is no stage or field `{}`", head.name),
            );
            return Err(problem.with_names(&head.name, known.iter().map(String::as_str)));
        };
        let place = place.at(&head.name);
        match node {
            StageOrLoop::Stage(stage) => self.in_stage(stage, rest, place),
            StageOrLoop::Rounds(rounds) => self.in_rounds(rounds, rest, place),
        }
    }

    fn in_rounds(
        &self,
        rounds: &mut Rounds,
        path: &[Segment],
        place: FieldPath,
    ) -> Result<FieldPath, Problem> {
        let (head, rest) = self.split(path)?;
        if head.name == "count" && rest.is_empty() {
            rounds.count = self.typed()?;
            return Ok(place.at("count"));
        }
        self.in_stages(&mut rounds.stages, path, place.at("stages"), &["count"])
    }

    /// By way of the stage as JSON, where fields have names and any value fits until it is read
    /// back.
    fn in_stage(
        &self,
        stage: &mut AnyStage,
        path: &[Segment],
        place: FieldPath,
    ) -> Result<FieldPath, Problem> {
        // A path that ends at the stage itself names no value.
        self.split(path)?;
        let whole = 0..self.source.text.len();
        let mut fields = stage
            .parameters()
            .map_err(|error| self.source.problem(whole, error.to_string()))?;
        *self.slot(&mut fields, path)? = self.value.clone();
        // Reading the whole stage back checks the new value as strictly as one in a file.
        *stage = AnyStage::from_parameters(stage.stage().kind(), fields).map_err(|error| {
            let message = format!("`{}`: {}", error.path(), error.inner());
            // serde tells the unknown name and the known ones in its message alone.
            let names = quoted(&message);
            let problem = self.source.problem(self.value_span.clone(), &message);
            // The first of these names is the path, which was put in front of serde's words.
            match (&names[1..], &self.value) {
                ([found, known @ ..], _) if !known.is_empty() => {
                    problem.with_names(found, known.iter().copied())
                }
                (_, Json::String(name)) if message.contains("unit variant") => {
                    problem.with_help(format!(
                        "a variant with fields has parentheses, even for its defaults: {name}()"
                    ))
                }
                _ => problem,
            }
        })?;
        Ok(path
            .iter()
            .fold(place, |place, segment| place.at(&segment.name)))
    }

    /// The value at a path. A variant's name is no step of the path: `guidance.lora_every` leads
    /// into `{"Vsd": {..}}`.
    fn slot<'v>(&self, mut value: &'v mut Json, path: &[Segment]) -> Result<&'v mut Json, Problem> {
        for segment in path {
            let missing = |value: &Json| {
                let problem = self.source.problem(
                    segment.span.clone(),
                    format!("there is no field `{}` here", segment.name),
                );
                match content(value).as_object() {
                    Some(fields) => {
                        problem.with_names(&segment.name, fields.keys().map(String::as_str))
                    }
                    None => problem.with_help(format!("what stands here is {}", content(value))),
                }
            };
            // Asked before going there: a missing field would otherwise be made, and a typing error
            // would pass unseen.
            let step = match content(value) {
                Json::Object(fields) => fields.contains_key(&segment.name),
                Json::Array(items) => segment.name.parse().is_ok_and(|at: usize| at < items.len()),
                _ => false,
            };
            if !step {
                return Err(missing(value));
            }
            value = match content_mut(value) {
                Json::Array(items) => &mut items[segment.name.parse().unwrap_or(0)],
                fields => &mut fields[segment.name.as_str()],
            };
        }
        Ok(value)
    }

    fn typed<T: serde::de::DeserializeOwned>(&self) -> Result<T, Problem> {
        serde_json::from_value(self.value.clone()).map_err(|error| {
            self.source
                .problem(self.value_span.clone(), error.to_string())
        })
    }
}

/// The steps of a path that stands `start` bytes into its text.
fn segments(path: &str, mut start: usize) -> Vec<Segment> {
    let segment = |name: &str| {
        let span = start..start + name.len();
        start = span.end + 1;
        Segment {
            name: name.to_owned(),
            span,
        }
    };
    path.split('.').map(segment).collect()
}

/// The name and content of a variant as serde writes one: an object with one key in
/// `UpperCamelCase`.
pub fn variant(value: &Json) -> Option<(&str, &Json)> {
    let fields = value.as_object().filter(|fields| fields.len() == 1)?;
    let (name, content) = fields.iter().next()?;
    // Fields of structs are in `snake_case`, so that a capital can only begin a variant.
    name.starts_with(|c: char| c.is_ascii_uppercase())
        .then_some((name.as_str(), content))
}

fn content(value: &Json) -> &Json {
    variant(value).map_or(value, |(_, content)| content)
}

fn content_mut(value: &mut Json) -> &mut Json {
    match variant(value).map(|(name, _)| name.to_owned()) {
        Some(name) => &mut value[name],
        None => value,
    }
}

/// The words that stand between backticks.
fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}
