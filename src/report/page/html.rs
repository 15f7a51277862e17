//! HTML as it is put together. Knows elements, and nothing of what they say.

use std::fmt::Write;

use super::crops::Crop;
use super::gallery::Shown;

/// A part of a page.
#[derive(Default)]
pub struct Html {
    /// What it is so far.
    pub text: String,
}

/// Text as HTML takes it, in elements and attributes.
pub fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            // Attributes stand in double quotes here, so that a single one needs no escape.
            '"' => safe.push_str("&quot;"),
            other => safe.push(other),
        }
    }
    safe
}

impl Html {
    /// Adds HTML.
    pub fn put(&mut self, html: &str) {
        self.text.push_str(html);
        self.text.push('\n');
    }

    /// Adds an element with text.
    pub fn tag(&mut self, name: &str, text: &str) {
        // Only texts are escaped: names of elements and classes are the program's own.
        let _ = writeln!(self.text, "<{name}>{}</{name}>", escaped(text));
    }

    /// Begins a section.
    pub fn section(&mut self, id: &str, title: &str) {
        let _ = writeln!(
            self.text,
            "<section id=\"{id}\"><h2>{}</h2>",
            escaped(title)
        );
    }

    /// Adds a list, if there is anything in it.
    pub fn list(&mut self, items: impl Iterator<Item = String>) {
        let items: Vec<String> = items
            .map(|item| format!("<li>{}</li>", escaped(&item)))
            .collect();
        if !items.is_empty() {
            self.put(&format!("<ul>{}</ul>", items.concat()));
        }
    }

    /// Adds a table whose first row is its head; `bold` says which cells of the others are, by row
    /// and column.
    pub fn table(&mut self, rows: &[Vec<String>], bold: impl Fn(usize, usize) -> bool) {
        let Some((head, body)) = rows.split_first() else {
            return;
        };
        let head: Vec<String> = head
            .iter()
            .map(|cell| format!("<th scope=\"col\">{}</th>", escaped(cell)))
            .collect();
        self.put("<div class=\"scroll\" tabindex=\"0\"><table>");
        self.put(&format!("<thead><tr>{}</tr></thead><tbody>", head.concat()));
        for (row, cells) in body.iter().enumerate() {
            let cell = |(column, text): (usize, &String)| match (column, bold(row, column)) {
                (0, _) => format!("<th scope=\"row\">{}</th>", escaped(text)),
                (_, true) => format!("<td><b>{}</b></td>", escaped(text)),
                (_, false) => format!("<td>{}</td>", escaped(text)),
            };
            let cells: Vec<String> = cells.iter().enumerate().map(cell).collect();
            self.put(&format!("<tr>{}</tr>", cells.concat()));
        }
        self.put("</tbody></table></div>");
    }

    /// Adds a picture with its caption.
    pub fn picture(&mut self, shown: &Shown, caption: &str, label: &str) {
        let _ = writeln!(
            self.text,
            "<figure><div class=\"pic {}\" role=\"img\" aria-label=\"{}\"></div><figcaption>{}</figcaption></figure>",
            shown.class(),
            escaped(label),
            escaped(caption),
        );
    }

    /// Adds a part of a picture with its caption, as wide as a whole one.
    pub fn crop(&mut self, shown: &Shown, crop: &Crop, caption: &str, label: &str) {
        let share = |at: usize, length: u32| {
            // In CSS, 100 % puts the picture's far edge at that of the box: percent are of what
            // does not fit.
            let room = (length as usize - crop.side).max(1);
            100.0 * at as f64 / room as f64
        };
        let style = format!(
            "--size:{:.2}%;background-position:{:.3}% {:.3}%",
            100.0 * f64::from(shown.picture.width) / crop.side as f64,
            share(crop.left, shown.picture.width),
            share(crop.top, shown.picture.height),
        );
        let _ = writeln!(
            self.text,
            "<figure><div class=\"crop {}\" style=\"{style}\" role=\"img\" aria-label=\"{}\"></div><figcaption>{}</figcaption></figure>",
            shown.class(),
            escaped(label),
            escaped(caption),
        );
    }
}
