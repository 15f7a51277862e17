//! What stages will take, in words: how long, how much memory, and how well that is known.

use serde_json::{Value, json};

use super::output::{print, size};
use crate::plan::{Basis, Cost};
use crate::progress::duration;
use crate::scheduler::budget::memory_limit;

/// A result of other parameters is some measure, and no result a weaker one.
const LIKE: &str = "~";
const GUESS: &str = "guess ";

/// A cell of a table: `12 s, 1.2 GB`, `~12 s, 1.2 GB` or `guess 12 s, 1.2 GB`.
pub fn words(cost: &Cost) -> String {
    let mark = match cost.basis {
        Basis::Result { .. } => "",
        Basis::Like { .. } => LIKE,
        Basis::Guess => GUESS,
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
    let largest = costs.clone().map(|cost| cost.memory).max();
    let Some(largest) = largest else {
        return;
    };
    let seconds = costs.clone().map(|cost| cost.seconds).sum();
    print(&format_args!(
        "\nabout {} one after the other, at most {} of memory; there are {}",
        duration(seconds),
        size(largest),
        size(memory_limit())
    ));
    if costs
        .clone()
        .any(|cost| matches!(cost.basis, Basis::Like { .. }))
    {
        print(&format_args!(
            "{LIKE}: by a result of the same kind with other parameters"
        ));
    }
    if costs.into_iter().any(|cost| cost.basis == Basis::Guess) {
        print(&format_args!(
            "{}: no such result is here; by parameters and by what is known of the inputs' sizes, on two cores, perhaps far off",
            GUESS.trim_end()
        ));
    }
}
