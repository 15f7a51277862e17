//! Rows of cells as Markdown, CSV or LaTeX. Knows nothing of what is in the cells.

use std::fmt::Write;

/// Rows of cells, the first of which is the head.
pub type Rows = Vec<Vec<String>>;

/// A table of Markdown, with numbers to the right.
pub fn markdown(rows: &Rows) -> String {
    let line = |row: &Vec<String>| {
        // A bare bar would begin another cell.
        let cells: Vec<String> = row.iter().map(|cell| cell.replace('|', "\\|")).collect();
        format!("| {} |", cells.join(" | "))
    };
    let Some((head, body)) = rows.split_first() else {
        return String::new();
    };
    let rule = format!("|---|{}", "--:|".repeat(head.len().saturating_sub(1)));
    let lines = [line(head), rule];
    let lines = lines.into_iter().chain(body.iter().map(line));
    lines.collect::<Vec<_>>().join("\n")
}

/// Comma-separated values.
pub fn csv(rows: &Rows) -> String {
    // RFC 4180: cells with commas, quotes or line breaks stand in quotes, and quotes in them are
    // doubled.
    let cell = |text: &String| match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.clone(),
    };
    let line = |row: &Vec<String>| row.iter().map(cell).collect::<Vec<_>>().join(",");
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// A table of LaTeX, for the package booktabs.
pub fn latex(rows: &Rows) -> String {
    let escaped = |cell: &String| {
        let mut text = String::new();
        for c in cell.chars() {
            match c {
                '_' | '%' | '&' | '#' | '$' | '{' | '}' => {
                    let _ = write!(text, "\\{c}");
                }
                '±' => text.push_str("$\\pm$"),
                '↑' => text.push_str("$\\uparrow$"),
                '↓' => text.push_str("$\\downarrow$"),
                // Character by character, so that the braces put in here are not escaped again.
                '\\' => text.push_str("\\textbackslash{}"),
                '^' => text.push_str("\\textasciicircum{}"),
                '~' => text.push_str("\\textasciitilde{}"),
                other => text.push(other),
            }
        }
        text
    };
    let line = |row: &Vec<String>| {
        let cells: Vec<String> = row.iter().map(escaped).collect();
        format!("{} \\\\", cells.join(" & "))
    };
    let Some((head, body)) = rows.split_first() else {
        return String::new();
    };
    let columns = "r".repeat(head.len().saturating_sub(1));
    let body: Vec<String> = body.iter().map(line).collect();
    format!(
        "\\begin{{tabular}}{{l{columns}}}\n\\toprule\n{}\n\\midrule\n{}\n\\bottomrule\n\\end{{tabular}}",
        line(head),
        body.join("\n")
    )
}
