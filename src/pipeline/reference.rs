//! What a reference means where it stands: `"stage"`, `"stage.output"`, `"loop.field"` or
//! `"@carried"`.

use std::collections::BTreeMap;

use super::fault::{Fault, FieldPath};
use super::grammar::{Named, Rounds, StageOrLoop};

/// The stages that can be named from some place, and for the inside of a loop, which round it is.
#[derive(Clone)]
pub struct Scope<'p> {
    /// What comes before these stages' names: `i3ds.2.`
    pub prefix: String,
    pub stages: &'p Named<StageOrLoop>,
    /// The loop and its round, from 1.
    pub turn: Option<(&'p Rounds, u32)>,
}

impl<'p> Scope<'p> {
    /// The inside of a loop.
    pub fn round(name: &str, rounds: &'p Rounds, round: u32) -> Self {
        Self {
            prefix: format!("{name}.{round}."),
            stages: &rounds.stages,
            turn: Some((rounds, round)),
        }
    }
}

/// An output of a stage: the first one where no name is given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    /// The stage's absolute name.
    pub stage: String,
    /// The output's name.
    pub output: Option<String>,
}

/// A reference that means nothing.
#[derive(Debug)]
pub struct Miss {
    message: String,
    found: String,
    known: Vec<String>,
}

impl Miss {
    fn new<'a>(message: String, found: &str, known: impl Iterator<Item = &'a str>) -> Self {
        Self {
            message,
            found: found.to_owned(),
            known: known.map(str::to_owned).collect(),
        }
    }

    /// The same as a fault at the place of the reference.
    pub fn fault(self, place: &FieldPath) -> Fault {
        place
            .fault(self.message)
            .with_names(&self.found, self.known.iter().map(String::as_str))
    }
}

/// What a reference means to a stage of the last scope; earlier scopes enclose it.
pub fn resolve(chain: &[Scope], reference: &str) -> Result<Target, Miss> {
    if let Some(name) = reference.strip_prefix('@') {
        return carried(chain, name);
    }
    // At the first dot: a loop's result has one name, and so has a stage's output.
    let (head, rest) = reference
        .split_once('.')
        .map_or((reference, None), |(head, rest)| (head, Some(rest)));
    // From the inside out: a stage of a loop hides one of the same name outside.
    for (depth, scope) in chain.iter().enumerate().rev() {
        let stage = format!("{}{head}", scope.prefix);
        match scope.stages.get(head) {
            Some(StageOrLoop::Stage(_)) => {
                return Ok(Target {
                    stage,
                    output: rest.map(str::to_owned),
                });
            }
            Some(StageOrLoop::Rounds(rounds)) => {
                return result(&chain[..=depth], &stage, rounds, rest.unwrap_or_default());
            }
            None => {}
        }
    }
    let known = chain.iter().rev().flat_map(|scope| scope.stages.names());
    Err(Miss::new(
        format!("there is no stage `{head}` to refer to"),
        head,
        known,
    ))
}

/// What a loop leaves behind: the `next` of its last round.
fn result(chain: &[Scope], name: &str, rounds: &Rounds, field: &str) -> Result<Target, Miss> {
    let Some(reference) = rounds.next.get(field) else {
        let message = match field {
            "" => format!("`{name}` is a loop: say which of its results is meant"),
            _ => format!("the loop `{name}` has no result `{field}`"),
        };
        return Err(Miss::new(message, field, rounds.next.names()));
    };
    // Seen from inside of the last round, whose stages `next` names.
    let last = Scope::round(name, rounds, rounds.count);
    resolve(
        &chain.iter().cloned().chain([last]).collect::<Vec<_>>(),
        &reference.0,
    )
}

/// As what, and in which round, something carried came to be: back through all rounds that did no
/// more than hand it on. There may be thousands, too many for a call each.
fn handed_on<'r>(rounds: &'r Rounds, mut name: &'r str, mut round: u32) -> (&'r str, u32) {
    let mut seen = BTreeMap::from([(name, round)]);
    while round > 1
        && let Some(next) = rounds.next.get(name)
        && let Some(before) = next.0.strip_prefix('@')
        && rounds.carry.get(name).is_some()
        && rounds.carry.get(before).is_some()
    {
        (name, round) = (before, round - 1);
        // A name that comes again does so every so many rounds: all of these but the last few are
        // passed over at once.
        if let Some(later) = seen.insert(name, round) {
            round = 1 + (round - 1) % (later - round);
        }
    }
    (name, round)
}

/// What a loop carries: in the first round what `carry` says, seen from outside; later what `next`
/// says, seen from the round before.
fn carried(chain: &[Scope], name: &str) -> Result<Target, Miss> {
    for (depth, scope) in chain.iter().enumerate().rev() {
        let Some((rounds, round)) = scope.turn else {
            continue;
        };
        // `carry` is written beside the loop, and so its names are those outside of it.
        let outside = &chain[..depth];
        let (name, origin) = handed_on(rounds, name, round);
        match (rounds.carry.get(name), rounds.next.get(name)) {
            (Some(first), _) if origin <= 1 => return resolve(outside, &first.0),
            (Some(_), Some(next)) => {
                let prefix = scope
                    .prefix
                    .strip_suffix(&format!(".{round}."))
                    .unwrap_or_default();
                // What is `next` is said by the stages of the round that ends.
                let before = Scope::round(prefix, rounds, origin - 1);
                return resolve(
                    &outside.iter().cloned().chain([before]).collect::<Vec<_>>(),
                    &next.0,
                );
            }
            _ => {}
        }
    }
    let known = chain
        .iter()
        .rev()
        .filter_map(|scope| scope.turn)
        .flat_map(|(rounds, _)| rounds.carry.names());
    Err(Miss::new(
        format!("nothing called `{name}` is carried here"),
        name,
        known,
    ))
}
