//! Words as shells and Python read them.

/// A word of a POSIX shell.
pub fn shell(word: &str) -> String {
    // The characters that Python's `shlex.quote` leaves alone too.
    let plain = |c: char| c.is_ascii_alphanumeric() || "%+,-./:=@_".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        // A shell knows no escapes within single quotes: they are closed, a quote is escaped, and
        // they are opened again.
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// A command line.
pub fn command(words: &[String]) -> String {
    words
        .iter()
        .map(|word| shell(word))
        .collect::<Vec<_>>()
        .join(" ")
}

/// A string of Python; control characters, which no shell word needs, are left out.
pub fn python(text: &str) -> String {
    let kept: String = text.chars().filter(|c| !c.is_control()).collect();
    format!("\"{}\"", kept.replace('\\', r"\\").replace('"', "\\\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_where_they_must_be() {
        assert_eq!(shell("i3ds.1.render"), "i3ds.1.render");
        assert_eq!(shell("a=Rsd()"), "'a=Rsd()'");
        assert_eq!(shell("it's"), r"'it'\''s'");
        assert_eq!(python("say \"a\\b\""), r#""say \"a\\b\"""#);
    }
}
