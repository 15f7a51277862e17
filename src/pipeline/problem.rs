//! What is wrong with a pipeline, and where: the message, the line, and the nearest name that would
//! do.

use std::fs::File;
use std::io::{self, Read};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use miette::{Diagnostic, NamedSource, SourceSpan};

/// A text that a user wrote: a pipeline file, or the argument of a `--set`.
#[derive(Clone, Debug)]
pub struct SourceText {
    /// The file's path as given, or the option's name.
    pub name: String,
    pub text: Arc<str>,
}

impl SourceText {
    /// The name of arguments of `--set`.
    pub const SET: &str = "--set";

    /// Bytes that a pipeline file may have, so that a device or a wrong file does not fill the
    /// memory.
    const LARGEST: u64 = 64 << 20;

    /// Reads a pipeline file.
    pub fn read(path: &Path) -> io::Result<Self> {
        let mut text = String::new();
        File::open(path)?
            // One byte more than allowed tells a file that is too large from one that just fits.
            .take(Self::LARGEST + 1)
            .read_to_string(&mut text)?;
        if text.len() as u64 > Self::LARGEST {
            return Err(io::Error::new(
                io::ErrorKind::FileTooLarge,
                "it has more than 64 MiB",
            ));
        }
        Ok(Self {
            name: path.display().to_string(),
            text: text.into(),
        })
    }

    /// A problem at these bytes of the text.
    pub fn problem(&self, span: Range<usize>, message: impl Into<String>) -> Problem {
        // A problem at the end of a text may point behind it, where there is nothing to show.
        let start = span.start.min(self.text.len());
        let length = span.end.clamp(start, self.text.len()) - start;
        Problem {
            message: message.into(),
            source_code: Arc::new(NamedSource::new(&self.name, self.text.to_string())),
            span: SourceSpan::from((start, length)),
            label: "here",
            help: None,
        }
    }

    /// The byte at a line and a column, both counted from 1, the column in characters.
    pub fn offset(&self, line: usize, column: usize) -> usize {
        let start: usize = self
            .text
            .split_inclusive('\n')
            .take(line.saturating_sub(1))
            .map(str::len)
            .sum();
        let rest = &self.text[start..];
        start
            + rest
                .char_indices()
                .nth(column.saturating_sub(1))
                .map_or(rest.len(), |(at, _)| at)
    }
}

/// What is wrong with a pipeline.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{message}")]
pub struct Problem {
    message: String,
    #[source_code]
    source_code: Arc<NamedSource<String>>,
    #[label("{label}")]
    span: SourceSpan,
    label: &'static str,
    #[help]
    help: Option<String>,
}

impl Problem {
    /// With advice on how to mend it.
    pub fn with_help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// With the nearest of the names that would do, or all of them where none is near.
    pub fn with_names<'a>(self, found: &str, known: impl IntoIterator<Item = &'a str>) -> Self {
        let known: Vec<&str> = known.into_iter().collect();
        match (nearest(found, &known), known.len()) {
            (Some(near), _) => self.with_help(format!("did you mean `{near}`?")),
            (None, 0) => self,
            (None, _) => self.with_help(format!("known here: {}", known.join(", "))),
        }
    }

    /// Where it is: `file:line:column`, counted from 1.
    pub fn place(&self) -> String {
        let text = self.source_code.inner();
        let before = &text[..self.span.offset().min(text.len())];
        let line = before.matches('\n').count() + 1;
        let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
        format!("{}:{line}:{column}", self.source_code.name())
    }

    /// Whether it is in an argument of `--set`, not in a file.
    pub fn is_in_argument(&self) -> bool {
        self.source_code.name() == SourceText::SET
    }

    /// The advice, if there is any.
    pub fn advice(&self) -> Option<&str> {
        self.help.as_deref()
    }
}

/// The nearest of the known names, if one is near enough to be meant.
pub fn nearest<'a>(found: &str, known: &[&'a str]) -> Option<&'a str> {
    let distance =
        // Case does not count: who writes `vsd` means `Vsd`.
        |name: &str| strsim::damerau_levenshtein(&found.to_lowercase(), &name.to_lowercase());
    let near = known.iter().copied().min_by_key(|name| distance(name))?;
    // A third of the name may be wrong, and one letter more. Beyond that a guess would only
    // mislead.
    (distance(near) <= near.chars().count().max(3) / 3 + 1).then_some(near)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_offered_only_if_near() {
        assert_eq!(
            nearest("optimise", &["optimize", "encode"]),
            Some("optimize")
        );
        assert_eq!(nearest("xyzzy", &["optimize", "encode"]), None);
    }

    #[test]
    fn places_are_lines_and_columns_in_characters() {
        let source = SourceText {
            name: "p.ron".into(),
            text: "é\néab".into(),
        };
        let at = source.offset(2, 2);
        assert_eq!(&source.text[at..], "ab");
        assert_eq!(source.problem(at..at + 1, "x").place(), "p.ron:2:2");
    }
}
