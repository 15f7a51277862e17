//! A pipeline file and the files that it extends, laid over each other: what all arms have in
//! common. Knows nothing of what references mean.

use std::path::Path;

use super::draft::Draft;
use super::fault::FieldPath;
use super::grammar::Document;
use super::malformed;
use super::problem::{Problem, SourceText};
use super::set::Override;
use super::text::{Entry, Tree, Value};

/// More files than this, each extending the next, are taken for a mistake.
const DEEPEST: usize = 16;

/// One file.
pub struct Layer {
    pub source: SourceText,
    /// What it says.
    pub document: Document,
    /// The same, with the place of each value.
    pub tree: Tree,
}

/// A file and those that it extends, itself first.
pub fn with_bases(source: SourceText) -> Result<Vec<SourceText>, Problem> {
    let mut files = vec![source];
    while let Some((path, span)) = files.last().and_then(base) {
        let extending = &files[files.len() - 1];
        // From the folder of the file that extends, so that it works from wherever the program is
        // started.
        let folder = Path::new(&extending.name).parent();
        let path = folder.unwrap_or(Path::new("")).join(path);
        // A file that extends itself has no end. Counting finds any circle, whatever names the
        // files go by.
        if files.len() == DEEPEST {
            let problem = extending.problem(span, "too many files extend each other here");
            return Err(problem.with_help("does one of them extend itself?"));
        }
        let base = SourceText::read(&path).map_err(|error| {
            let message = format!("cannot read {}: {error}", path.display());
            let problem = extending.problem(span, message);
            problem.with_help("the path of a base is relative to the file that extends it")
        })?;
        files.push(base);
    }
    Ok(files)
}

/// The file that a text extends, and where it says so. What is wrong with the text is found when it
/// is read.
fn base(source: &SourceText) -> Option<(String, std::ops::Range<usize>)> {
    // Most files extend none, and may be long.
    if !source.text.contains("base") {
        return None;
    }
    let tree = Tree::read(&source.text).ok()?;
    match &tree.entry("base")?.tree {
        Tree {
            span,
            value: Value::Scalar(serde_json::Value::String(path)),
        } => Some((path.clone(), span.clone())),
        _ => None,
    }
}

impl Layer {
    /// Reads a file's text.
    pub fn read(source: &SourceText) -> Result<Self, Problem> {
        let extensions = ron::extensions::Extensions::UNWRAP_VARIANT_NEWTYPES
            | ron::extensions::Extensions::IMPLICIT_SOME;
        // Set for every file: users need not write `#![enable(..)]`, `Some(..)` or double
        // parentheses.
        let options = ron::Options::default().with_default_extension(extensions);
        // The text is read twice: `ron` gives the types, and the tree the places that serde does
        // not tell.
        let document = options
            .from_str(&source.text)
            .map_err(|error| malformed(source, &error))?;
        let tree = Tree::read(&source.text).map_err(|garbled| {
            let message = format!("expected {}", garbled.expected);
            source.problem(garbled.at..garbled.at + 1, message)
        })?;
        Ok(Self {
            source: source.clone(),
            document,
            tree,
        })
    }

    /// What stands under a name at the top of the file.
    pub fn field(&self, name: &str) -> Option<&Tree> {
        self.tree.entry(name).map(|entry| &entry.tree)
    }

    /// Something wrong with what stands under a name at the top of the file.
    pub fn problem(&self, name: &str, message: impl Into<String>) -> Problem {
        let span = self.field(name).map_or(0..0, |tree| tree.span.clone());
        self.source.problem(span, message)
    }

    /// The entries of a map, each name once.
    pub fn entries<'t>(&self, tree: &'t Tree, of: &str) -> Result<&'t [Entry], Problem> {
        let Value::Map(entries) = &tree.value else {
            let problem = self
                .source
                .problem(tree.span.clone(), format!("expected {of}"));
            return Err(problem.with_help("names stand in quotes, inside braces"));
        };
        for (at, entry) in entries.iter().enumerate() {
            if entries[..at]
                .iter()
                .any(|earlier| earlier.name == entry.name)
            {
                let message = format!("`{}` is given twice", entry.name);
                return Err(self.source.problem(entry.span.clone(), message));
            }
        }
        Ok(entries)
    }

    /// The differences that stand in a map of paths and values.
    pub fn differences(&self, tree: &Tree) -> Result<Vec<Override>, Problem> {
        let entries = self.entries(tree, "paths and values: { \"fit.steps\": 2000 }")?;
        let read = |entry| Override::of_entry(&self.source, entry);
        Ok(entries.iter().map(read).collect())
    }

    /// Lays this file over what it extends.
    fn lay_over(&self, draft: &mut Draft) -> Result<(), Problem> {
        // Taken out before anything is put in: a file may replace a stage by another at the end.
        for name in &self.document.without {
            let stages = &mut draft.pipeline.stages;
            let known: Vec<String> = stages.names().map(str::to_owned).collect();
            if !stages.remove(name) {
                let problem = self.problem("without", format!("there is no stage `{name}`"));
                return Err(problem.with_names(name, known.iter().map(String::as_str)));
            }
        }
        for (name, node) in self.document.stages.iter() {
            draft.pipeline.stages.put(name, node.clone());
            draft.forget(&FieldPath::root("stages").at(name));
        }
        draft.pipeline.name.clone_from(&self.document.name);
        draft.forget(&FieldPath::root("name"));
        draft.pipeline.seed = self.document.seed.unwrap_or(draft.pipeline.seed);
        // Last, so that values can be set in the stages that this file itself adds.
        match self.field("set") {
            Some(set) => draft.apply_all(self.differences(set)?),
            None => Ok(()),
        }
    }
}

/// What a file says, with the files that it extends under it. The first layer is the file itself.
pub fn lay(layers: &[Layer]) -> Result<Draft, Problem> {
    let mut draft = Draft::default();
    if let Some(root) = layers.last().filter(|root| root.field("set").is_some()) {
        let problem = root.problem("set", "there is no file that these values are of");
        return Err(
            problem.with_help("name it (base: \"i3ds.ron\"), or give the stages their values")
        );
    }
    // From the innermost file outwards: what extends another has the last word.
    for layer in layers.iter().rev() {
        layer.lay_over(&mut draft)?;
    }
    Ok(draft)
}

/// Where a place stands: in the outermost file that spells out its stage, else in the innermost.
pub fn locate<'l>(layers: &'l [Layer], place: &FieldPath) -> Option<&'l Layer> {
    let spells_out = |layer: &&Layer| {
        // Two steps name the stage: `stages`, `fit`. The file that spells it out is the one to look
        // into.
        let steps = place.0.iter().take(2);
        let mut tree = Some(&layer.tree);
        for step in steps {
            tree = tree
                .and_then(|tree| tree.entry(step))
                .map(|entry| &entry.tree);
        }
        tree.is_some()
    };
    layers.iter().find(spells_out).or(layers.last())
}
