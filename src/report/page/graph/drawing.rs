//! A graph as an SVG: boxes from left to right, with lines between them. Knows places, and nothing
//! of the store.

use std::fmt::Write;

use super::{Node, ProvenanceGraph};
use crate::report::page::html::escaped;
use crate::store::runs::End;
use crate::terminal::output::size;
use crate::terminal::progress::duration;

/// A box, and the way from one to the next, in pixels.
const BOX: [usize; 2] = [150, 46];
const STEP: [usize; 2] = [182, 58];
/// Room around the drawing.
const MARGIN: usize = 4;
/// Letters that fit in a box.
const LETTERS: usize = 23;

impl ProvenanceGraph {
    /// The whole drawing.
    pub fn svg(&self) -> String {
        let far = |of: fn(&Node) -> usize| self.nodes.iter().map(of).max().unwrap_or(0);
        let width = far(|node| node.column) * STEP[0] + BOX[0] + 2 * MARGIN;
        let height = far(|node| node.row) * STEP[1] + BOX[1] + 2 * MARGIN;
        let mut svg = format!(
            "<svg width=\"{width}\" height=\"{height}\" role=\"img\" \
             aria-label=\"The stages and what each is made from; the table below has the same\">"
        );
        // Lines first, so that boxes lie over them.
        for node in &self.nodes {
            for &parent in &node.parents {
                line(&mut svg, &self.nodes[parent], node);
            }
        }
        self.nodes.iter().for_each(|node| boxed(&mut svg, node));
        svg + "</svg>"
    }
}

impl Node {
    fn corner(&self) -> [usize; 2] {
        [self.column * STEP[0] + MARGIN, self.row * STEP[1] + MARGIN]
    }

    /// The arms in few words.
    fn owners(&self) -> String {
        match &self.arms[..] {
            [] => String::new(),
            [arm] => arm.clone(),
            arms => format!("{} arms", arms.len()),
        }
    }

    fn cost(&self) -> String {
        let Some((seconds, memory)) = self.cost else {
            return "no result".to_owned();
        };
        let memory = memory.map_or(String::new(), |bytes| format!(", {}", size(bytes)));
        format!("{}{memory}", duration(seconds))
    }

    /// All that is known, for who points at the box.
    fn title(&self) -> String {
        let arms = match self.arms.is_empty() {
            true => String::new(),
            false => format!("{}: ", self.arms.join(", ")),
        };
        let why = self.reason.iter().map(|why| format!(" Why: {why}"));
        format!("{arms}{}.{}", state(self.end), why.collect::<String>())
    }
}

/// How a stage ended, which is also the class of its box.
fn state(end: End) -> &'static str {
    match end {
        End::Ran => "ran",
        End::Cached => "cached",
        End::Failed => "failed",
        End::Stopped => "stopped",
    }
}

/// From the right side of one box to the left side of another.
fn line(svg: &mut String, from: &Node, to: &Node) {
    let [left, top] = from.corner();
    let start = [left + BOX[0], top + BOX[1] / 2];
    let [left, top] = to.corner();
    let end = [left, top + BOX[1] / 2];
    // A node stands in a later column than its parents, so no difference is below 0.
    let bend = (STEP[0] - BOX[0]).max((end[0] - start[0]) / 3);
    let _ = write!(
        svg,
        "<path d=\"M{} {}C{} {} {} {} {} {}\"/>",
        start[0],
        start[1],
        start[0] + bend,
        start[1],
        end[0] - bend,
        end[1],
        end[0],
        end[1],
    );
}

fn boxed(svg: &mut String, node: &Node) {
    let [left, top] = node.corner();
    let _ = write!(
        svg,
        "<g class=\"{}\"><title>{}</title><rect x=\"{left}\" y=\"{top}\" width=\"{}\" height=\"{}\" rx=\"5\"/>",
        state(node.end),
        escaped(&node.title()),
        BOX[0],
        BOX[1],
    );
    let lines = [node.stage.clone(), node.owners(), node.cost()];
    for (number, text) in lines.iter().enumerate() {
        let _ = write!(
            svg,
            "<text x=\"{}\" y=\"{}\">{}</text>",
            left + 7,
            top + 14 + 13 * number,
            escaped(&shortened(text)),
        );
    }
    svg.push_str("</g>");
}

/// As much of a text as fits in a box.
fn shortened(text: &str) -> String {
    if text.chars().count() <= LETTERS {
        return text.to_owned();
    }
    let kept: String = text.chars().take(LETTERS - 1).collect();
    kept + "\u{2026}"
}
