//! The reference of stage kinds: the page in `docs/` is what the program prints.
//!
//! `UPDATE=1` rewrites the page and the schema.

use std::path::Path;

use crate::space::Space;

/// Compares what the command prints with a file of the repository.
fn check(file: &str, printed: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, printed).unwrap();
    }
    let stored = std::fs::read_to_string(&path).unwrap();
    assert!(
        stored == printed,
        "{file} is out of date: run the tests with UPDATE=1"
    );
}

#[test]
fn the_page_is_what_the_program_prints() {
    check("docs/stages.md", &Space::new().ok(&["kinds", "--all"]).out);
}

#[test]
fn the_schema_for_editors_is_what_the_program_prints() {
    check(
        "docs/stages.schema.json",
        &Space::new().ok(&["kinds", "--json"]).out,
    );
}

#[test]
fn a_kind_is_shown_with_its_parameters_ranges_and_defaults() {
    let shown = Space::new().ok(&["kinds", "scene"]).out;
    for words in [
        "## Scene",
        "Writes `train` (images), `test` (images), `test_low` (images).",
        "| `holdout` | whole number, 2 to 1000000 | `8` |",
        "`Bicubic`, `Area`",
        "`source: Llff(..)`",
    ] {
        assert!(shown.contains(words), "{words} is not in: {shown}");
    }
}

#[test]
fn all_kinds_are_listed_and_a_wrong_one_is_refused() {
    let space = Space::new();
    let list = space.ok(&["kinds"]).out;
    assert!(
        list.lines().count() > 9 && list.contains("Fit          Fits a hash-grid field"),
        "{list}"
    );
    let said = space.say(&["kinds", "Fitt"]);
    assert_eq!(said.code, 2);
    assert!(said.err.contains("there is no kind `Fitt`"), "{}", said.err);
    assert!(
        said.err.contains("the kinds are Scene, Fit"),
        "{}",
        said.err
    );
}
