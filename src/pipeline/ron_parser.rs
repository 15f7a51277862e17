//! Parses RON text into a [`Tree`]: values, names and where they stand. Knows no types.

use serde_json::{Number, Value as Json};

use super::text::{Entry, Garbled, Tree, Value};

/// How deep values may nest.
const DEPTH: usize = 64;

/// Parses one text.
pub struct RonParser<'t> {
    text: &'t str,
    at: usize,
    depth: usize,
}

impl<'t> RonParser<'t> {
    /// At the start of a text.
    pub fn new(text: &'t str) -> Self {
        Self {
            text,
            at: 0,
            depth: 0,
        }
    }

    /// The value that the whole text is.
    pub fn whole(mut self) -> Result<Tree, Garbled> {
        self.attributes()?;
        let tree = self.tree()?;
        self.space();
        if self.at == self.text.len() {
            Ok(tree)
        } else {
            Err(self.garbled("nothing more"))
        }
    }

    fn rest(&self) -> &'t str {
        &self.text[self.at..]
    }

    fn garbled(&self, expected: &'static str) -> Garbled {
        Garbled {
            at: self.at,
            expected,
        }
    }

    /// Skips `#![enable(..)]` lines.
    fn attributes(&mut self) -> Result<(), Garbled> {
        self.space();
        while self.rest().starts_with("#!") {
            // What they enable is for `ron` to know. Places of values do not depend on it.
            let end = self.rest().find(']').ok_or(self.garbled("`]`"))?;
            self.at += end + 1;
            self.space();
        }
        Ok(())
    }

    /// Skips blanks and comments.
    fn space(&mut self) {
        loop {
            let rest = self.rest();
            let trimmed = rest.trim_start();
            self.at += rest.len() - trimmed.len();
            // `get`, since the second byte can lie inside of a character.
            match trimmed.get(..2) {
                Some("//") => self.at += trimmed.find('\n').unwrap_or(trimmed.len()),
                Some("/*") => self.at += block_comment(trimmed),
                _ => return,
            }
        }
    }

    fn eat(&mut self, mark: char) -> bool {
        self.space();
        let found = self.rest().starts_with(mark);
        if found {
            self.at += mark.len_utf8();
        }
        found
    }

    fn need(&mut self, mark: char, expected: &'static str) -> Result<(), Garbled> {
        if self.eat(mark) {
            Ok(())
        } else {
            Err(self.garbled(expected))
        }
    }

    fn tree(&mut self) -> Result<Tree, Garbled> {
        self.space();
        // Values are read by recursion. A text of nothing but brackets must not use up the stack.
        if self.depth == DEPTH {
            return Err(self.garbled("less nesting"));
        }
        self.depth += 1;
        let start = self.at;
        let value = match self.rest().chars().next() {
            Some('(') => self.parens(None)?,
            Some('[') => self.list()?,
            Some('{') => self.map()?,
            Some('"') => Value::Scalar(self.string()?.into()),
            // A name can begin with this letter too.
            Some('r') if self.rest().starts_with("r\"") || self.rest().starts_with("r#") => {
                Value::Scalar(self.raw_string()?.into())
            }
            Some(c) if c.is_ascii_digit() || "+-.".contains(c) => {
                Value::Scalar(Json::Number(self.number()?))
            }
            Some(c) if c.is_alphabetic() || c == '_' => self.named()?,
            _ => return Err(self.garbled("a value")),
        };
        self.depth -= 1;
        Ok(Tree {
            span: start..self.at,
            value,
        })
    }

    fn named(&mut self) -> Result<Value, Garbled> {
        let name = self.identifier()?;
        match name {
            "true" => Ok(Value::Scalar(true.into())),
            "false" => Ok(Value::Scalar(false.into())),
            "None" => Ok(Value::Scalar(Json::Null)),
            // Blanks alone: `ron` takes no comment there either.
            _ if self.rest().trim_start().starts_with('(') => self.parens(Some(name.to_owned())),
            _ => Ok(Value::Tuple(Some(name.to_owned()), Vec::new())),
        }
    }

    /// `(..)`: a struct if its first item is `name:`.
    fn parens(&mut self, name: Option<String>) -> Result<Value, Garbled> {
        self.need('(', "`(`")?;
        if self.at_field() {
            let entries = self.separated(')', "`,` or `)`", |reader| {
                reader.space();
                let start = reader.at;
                let name = reader.identifier()?.to_owned();
                reader.entry(name, start)
            })?;
            return Ok(Value::Struct(name, entries));
        }
        let items = self.separated(')', "`,` or `)`", Self::tree)?;
        // `Rsd()` has all its fields at their defaults, which `Rsd` alone could not say.
        if items.is_empty() {
            Ok(Value::Struct(name, Vec::new()))
        } else {
            Ok(Value::Tuple(name, items))
        }
    }

    fn at_field(&mut self) -> bool {
        let before = self.at;
        self.space();
        // `(a: 1)` and `(a, b)` begin alike, so the colon is looked for before anything is taken.
        let field = self.identifier().is_ok() && self.eat(':');
        self.at = before;
        field
    }

    fn list(&mut self) -> Result<Value, Garbled> {
        self.need('[', "`[`")?;
        Ok(Value::List(self.separated(
            ']',
            "`,` or `]`",
            Self::tree,
        )?))
    }

    fn map(&mut self) -> Result<Value, Garbled> {
        self.need('{', "`{`")?;
        let entries = self.separated('}', "`,` or `}`", |reader| {
            reader.space();
            let start = reader.at;
            let name = reader.string()?;
            reader.entry(name, start)
        })?;
        Ok(Value::Map(entries))
    }

    fn entry(&mut self, name: String, start: usize) -> Result<Entry, Garbled> {
        let span = start..self.at;
        self.need(':', "`:`")?;
        Ok(Entry {
            name,
            span,
            tree: self.tree()?,
        })
    }

    fn separated<T>(
        &mut self,
        close: char,
        expected: &'static str,
        mut item: impl FnMut(&mut Self) -> Result<T, Garbled>,
    ) -> Result<Vec<T>, Garbled> {
        let mut items = Vec::new();
        while !self.eat(close) {
            items.push(item(self)?);
            // A comma may stand behind the last item too, where the loop finds the end.
            if !self.eat(',') {
                self.need(close, expected)?;
                break;
            }
        }
        Ok(items)
    }

    fn identifier(&mut self) -> Result<&'t str, Garbled> {
        let rest = self.rest();
        let length = rest
            .find(|c: char| !c.is_alphanumeric() && c != '_')
            .unwrap_or(rest.len());
        if length == 0 || rest.starts_with(|c: char| c.is_ascii_digit()) {
            return Err(self.garbled("a name"));
        }
        self.at += length;
        Ok(&rest[..length])
    }

    fn number(&mut self) -> Result<Number, Garbled> {
        let rest = self.rest();
        let length = rest
            .find(|c: char| !c.is_ascii_alphanumeric() && !"+-._".contains(c))
            .unwrap_or(rest.len());
        // `ron` takes `1_000` too, and both have to agree on every file.
        let digits = rest[..length].replace('_', "");
        // Whole numbers first: as floats, seeds above 2^53 would lose their last digits.
        let number = whole(&digits).or_else(|| digits.parse().ok().and_then(Number::from_f64));
        let number = number.ok_or(self.garbled("a number"))?;
        self.at += length;
        Ok(number)
    }

    fn string(&mut self) -> Result<String, Garbled> {
        let rest = self.rest();
        let mut escaped = false;
        let close = rest.char_indices().skip(1).find(|&(_, c)| {
            let closes = c == '"' && !escaped;
            escaped = c == '\\' && !escaped;
            closes
        });
        let (Some((end, _)), true) = (close, rest.starts_with('"')) else {
            return Err(self.garbled("a string in quotes"));
        };
        // A quoted string has the same escapes for the `ron` crate, which reads it here.
        let string =
            ron::from_str(&rest[..=end]).map_err(|_| self.garbled("a string in quotes"))?;
        self.at += end + 1;
        Ok(string)
    }

    fn raw_string(&mut self) -> Result<String, Garbled> {
        let rest = self.rest();
        let hashes = rest[1..].chars().take_while(|&c| c == '#').count();
        // As many hashes as it was opened with: fewer of them may stand within the string.
        let close = format!("\"{}", "#".repeat(hashes));
        let body = rest.get(hashes + 2..).ok_or(self.garbled("a raw string"))?;
        let end = body.find(&close).ok_or(self.garbled("a raw string"))?;
        self.at += hashes + 2 + end + close.len();
        Ok(body[..end].to_owned())
    }
}

/// A whole number in any base.
fn whole(digits: &str) -> Option<Number> {
    let based = |prefix: &str, radix| u64::from_str_radix(digits.strip_prefix(prefix)?, radix).ok();
    let unsigned = based("0x", 16)
        .or_else(|| based("0b", 2))
        .or_else(|| based("0o", 8))
        .or_else(|| digits.parse().ok());
    unsigned
        .map(Number::from)
        // Unsigned before signed, so that numbers above the largest `i64` are read too.
        .or_else(|| digits.parse::<i64>().ok().map(Number::from))
}

/// The length of the block comment that opens the text; such comments nest.
fn block_comment(text: &str) -> usize {
    let mut depth = 0;
    let mut at = 0;
    while at < text.len() {
        match text.get(at..at + 2) {
            Some("/*") => (depth, at) = (depth + 1, at + 2),
            Some("*/") => (depth, at) = (depth - 1, at + 2),
            // A step can end inside of a character, where `get` finds no text and the loop goes on.
            _ => at += 1,
        }
        if depth == 0 {
            return at;
        }
    }
    text.len()
}
