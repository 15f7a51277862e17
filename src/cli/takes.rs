//! What stages will take, in words: how long, how much memory, and how well that is known.

use serde_json::{Value, json};

use crate::runner::plan::{Basis, Cost};
use crate::runner::scheduler::memory_limit::memory_limit;
use crate::terminal::output::{print, size};
use crate::terminal::progress::duration;

/// Marks of costs that no result of the same parameters tells: those by a similar result, and those
/// by the stage's own estimate.
const LIKE: &str = "~";
const GUESS: &str = "guess";

/// A cell of a table: `12 s, 1.2 GB`, `~12 s, 1.2 GB` or `guess 12 s, 1.2 GB`.
pub fn words(cost: &Cost) -> String {
    let mark = match cost.basis {
        Basis::Result { .. } => String::new(),
        Basis::Like { .. } => LIKE.to_owned(),
        Basis::Guess => format!("{GUESS} "),
    };
    let took = duration(cost.seconds);
    format!("{mark}{took}, {}", size(cost.memory))
}

/// The same for programs.
pub fn json(cost: &Cost) -> Value {
    let (from, stage, but) = match &cost.basis {
        Basis::Result { stage } => ("result", Some(stage), &[][..]),
        Basis::Like { stage, but } => ("like_result", Some(stage), &but[..]),
        Basis::Guess => ("estimate", None, &[][..]),
    };
    json!({"seconds": cost.seconds, "memory": cost.memory, "from": from, "of": stage, "but": but})
}

/// Says what all take together, and what the marks mean.
pub fn tell<'c>(costs: impl Iterator<Item = &'c Cost> + Clone) {
    // The largest and not the sum: one after the other, stages give their memory back.
    let largest = costs.clone().map(|cost| cost.memory).max();
    let Some(largest) = largest else {
        return;
    };
    let seconds = costs.clone().map(|cost| cost.seconds).sum();
    print(&format_args!(
        "\nabout {} one after the other, {} of memory at a time; there are {}",
        duration(seconds),
        size(largest),
        size(memory_limit())
    ));
    if costs
        .clone()
        .any(|cost| matches!(cost.basis, Basis::Like { .. }))
    {
        print(&format_args!(
            "{LIKE} by a result of the same kind with other parameters"
        ));
    }
    if costs.into_iter().any(|cost| cost.basis == Basis::Guess) {
        print(&format_args!(
            "{GUESS} by parameters and by the sizes of what is read, since no such result is here: perhaps far off"
        ));
    }
}
