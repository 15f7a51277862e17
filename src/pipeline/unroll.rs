//! Loops unrolled and references resolved: from a pipeline as written to stages wired to each
//! other.
//!
//! A stage of round 2 of the loop `i3ds` is called `i3ds.2.render`. Knows nothing of files: faults
//! name a place in the pipeline.

use std::collections::BTreeMap;

use artifacts_schema::ArtifactKind;
use stages::registry::AnyStage;
use stages::{Input, StageError};

use super::fault::{Fault, FieldPath};
use super::grammar::{Pipeline, Rounds, StageOrLoop};
use super::graph::{self, Graph, Wire};
use super::reference::{Scope, Target, resolve};
use super::shard;

/// More rounds than this are taken for a mistake.
const MOST_ROUNDS: u32 = 10_000;

/// A stage with an absolute name, and what its inputs refer to.
struct Unrolled<'p> {
    name: String,
    seed: u64,
    stage: &'p AnyStage,
    place: FieldPath,
    links: Vec<Link>,
}

struct Link {
    input: String,
    kind: ArtifactKind,
    target: Target,
}

/// The seeds of stages outside loops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seeds {
    /// Of stages that compute from what others give.
    pub computing: u64,
    /// Of stages that read nothing of others: with every seed of an experiment they give the same
    /// photos.
    pub sources: u64,
}

impl Seeds {
    /// One seed for all stages.
    pub fn all(seed: u64) -> Self {
        Self {
            computing: seed,
            sources: seed,
        }
    }

    fn in_round(self, round: u32) -> Self {
        Self {
            computing: round_seed(self.computing, round),
            sources: round_seed(self.sources, round),
        }
    }

    fn of(self, stage: &AnyStage) -> u64 {
        if stage.stage().inputs().is_empty() {
            self.sources
        } else {
            self.computing
        }
    }
}

/// Unrolls all loops, checks every stage, and wires all inputs.
pub fn unroll(pipeline: &Pipeline, seeds: Seeds) -> Result<Graph, Fault> {
    let mut all = Vec::new();
    let scope = Scope {
        prefix: String::new(),
        stages: &pipeline.stages,
        turn: None,
    };
    unroll_stages(&[scope], seeds, &FieldPath::root("stages"), &mut all)?;
    if all.is_empty() {
        return Err(FieldPath::root("stages").fault("the pipeline has no stages"));
    }
    // Wires come after all stages are known, since a reference may point to a stage further down.
    let index: BTreeMap<&str, usize> = all
        .iter()
        .enumerate()
        .map(|(at, stage)| (stage.name.as_str(), at))
        .collect();
    let wires = all
        .iter()
        .map(|stage| wires(stage, &all, &index))
        .collect::<Result<Vec<_>, _>>()?;
    let nodes = all
        .into_iter()
        .zip(wires)
        .map(|(stage, wires)| node(stage, wires))
        .collect::<Result<Vec<_>, _>>()?;
    let (nodes, places): (Vec<graph::Node>, Vec<FieldPath>) = nodes.into_iter().unzip();
    let graph = Graph::new(pipeline.name.clone(), nodes);
    let graph = graph.map_err(|at| places[at].fault("this stage depends on itself in a circle"))?;
    // After the order is found: each part then stands just before its merge.
    shard::shard(graph)
}

/// The seed of a loop's round: independent of other rounds', and of the seed outside.
pub fn round_seed(seed: u64, round: u32) -> u64 {
    seed_within("srnerf-dag round seed v1", seed, round)
}

/// A seed of its own for each number, in a domain of its own.
pub fn seed_within(domain: &str, seed: u64, number: u32) -> u64 {
    let mut hasher = blake3::Hasher::new_derive_key(domain);
    hasher
        .update(&seed.to_le_bytes())
        .update(&number.to_le_bytes());
    // The first eight bytes of the digest, in an order that is the same on every machine.
    let mut bytes = [0; 8];
    hasher.finalize_xof().fill(&mut bytes);
    u64::from_le_bytes(bytes)
}

fn unroll_stages<'p>(
    chain: &[Scope<'p>],
    seeds: Seeds,
    place: &FieldPath,
    all: &mut Vec<Unrolled<'p>>,
) -> Result<(), Fault> {
    let Some(scope) = chain.last() else {
        return Ok(());
    };
    for (name, node) in scope.stages.iter() {
        let full = format!("{}{name}", scope.prefix);
        let place = place.at(name);
        check_name(name, &place)?;
        match node {
            StageOrLoop::Stage(stage) => {
                all.push(unrolled(chain, full, seeds.of(stage), stage, place)?);
            }
            StageOrLoop::Rounds(rounds) => unroll_rounds(chain, &full, seeds, rounds, &place, all)?,
        }
    }
    Ok(())
}

fn unroll_rounds<'p>(
    chain: &[Scope<'p>],
    name: &str,
    seeds: Seeds,
    rounds: &'p Rounds,
    place: &FieldPath,
    all: &mut Vec<Unrolled<'p>>,
) -> Result<(), Fault> {
    if !(1..=MOST_ROUNDS).contains(&rounds.count) {
        return Err(place.at("count").fault(format!(
            "`count` is {}; it must be 1 to {MOST_ROUNDS}",
            rounds.count
        )));
    }
    for (carried, reference) in rounds.carry.iter() {
        // Checked even if no stage reads it: a mistake should not wait until somebody does.
        resolve(chain, &reference.0).map_err(|miss| miss.fault(&place.at("carry").at(carried)))?;
        // Asked for even where `count` is 1: more rounds must not break a pipeline.
        if rounds.next.get(carried).is_none() {
            let message = format!(
                "`{carried}` is carried, but `next` does not say what it is in the next round"
            );
            return Err(place.at("carry").at(carried).fault(message));
        }
    }
    for round in 1..=rounds.count {
        let inner = Scope::round(name, rounds, round);
        let chain: Vec<Scope> = chain.iter().cloned().chain([inner]).collect();
        // In each round anew, since `@name` means something else in the first than in later ones.
        for (carried, reference) in rounds.next.iter() {
            resolve(&chain, &reference.0)
                .map_err(|miss| miss.fault(&place.at("next").at(carried)))?;
        }
        unroll_stages(&chain, seeds.in_round(round), &place.at("stages"), all)?;
    }
    Ok(())
}

/// Names become folders and are joined by dots.
pub fn check_name(name: &str, place: &FieldPath) -> Result<(), Fault> {
    let good = |c: char| c.is_ascii_alphanumeric() || "_-".contains(c);
    match name.chars().next() {
        Some(first)
            // A dot would be taken for a step of a reference, and a slash for the end of an arm's
            // name.
            if first.is_ascii_alphabetic() && name.chars().all(good) && name.len() <= 64 =>
        {
            Ok(())
        }
        _ => Err(place.fault(format!(
            "`{name}` is no name: names are a letter, then letters, digits, `_` and `-`"
        ))),
    }
}

fn unrolled<'p>(
    chain: &[Scope],
    name: String,
    seed: u64,
    any: &'p AnyStage,
    place: FieldPath,
) -> Result<Unrolled<'p>, Fault> {
    any.stage()
        .check()
        .map_err(|error| parameter_fault(&error, &place))?;
    let mut links = Vec::new();
    for port in any.stage().inputs().iter().filter(|port| port.used) {
        // Ports that these parameters do not use may stay unconnected.
        let Input(reference) = port.reference;
        if reference.is_empty() {
            let message = format!(
                "input `{}` is not connected: it takes {} of another stage",
                port.name, port.kind
            );
            return Err(place.fault(message));
        }
        let target = resolve(chain, reference).map_err(|miss| miss.fault(&place.at(port.name)))?;
        links.push(Link {
            input: port.name.to_owned(),
            kind: port.kind,
            target,
        });
    }
    Ok(Unrolled {
        name,
        seed,
        stage: any,
        place,
        links,
    })
}

fn parameter_fault(error: &StageError, place: &FieldPath) -> Fault {
    match error {
        StageError::Parameter { field, .. } => place.within(field).fault(error.to_string()),
        _ => place.fault(error.to_string()),
    }
}

fn wires(
    stage: &Unrolled,
    all: &[Unrolled],
    index: &BTreeMap<&str, usize>,
) -> Result<Vec<Wire>, Fault> {
    stage
        .links
        .iter()
        // The place is put together for an error alone: there may be thousands of wires.
        .map(|link| wire(link, &|| stage.place.at(&link.input), all, index))
        .collect()
}

fn wire(
    link: &Link,
    place: &dyn Fn() -> FieldPath,
    all: &[Unrolled],
    index: &BTreeMap<&str, usize>,
) -> Result<Wire, Fault> {
    let Target { stage, output } = &link.target;
    let from = *index
        .get(stage.as_str())
        .ok_or_else(|| place().fault(format!("there is no stage `{stage}`")))?;
    let outputs = all[from].stage.stage().outputs();
    let found = match output {
        Some(name) => outputs.iter().find(|port| port.name == name),
        None => outputs.first(),
    };
    let Some(port) = found else {
        let name = output.clone().unwrap_or_default();
        return Err(place()
            .fault(format!("`{stage}` has no output `{name}`"))
            .with_names(&name, outputs.iter().map(|o| o.name)));
    };
    if port.kind != link.kind {
        // The most likely mistake is the right stage with the wrong output.
        let fitting = outputs.iter().find(|other| other.kind == link.kind);
        let fault = place().fault(format!(
            "`{}` takes {}, but `{stage}.{}` is {}",
            link.input, link.kind, port.name, port.kind
        ));
        return Err(
            fault.with_help(fitting.map(|port| format!("`{stage}.{}` would fit", port.name)))
        );
    }
    Ok(Wire {
        input: link.input.clone(),
        from,
        output: port.name,
    })
}

fn node(unrolled: Unrolled, wires: Vec<Wire>) -> Result<(graph::Node, FieldPath), Fault> {
    let Unrolled {
        name,
        seed,
        stage,
        place,
        ..
    } = unrolled;
    let params = stage
        .parameters()
        .map_err(|error| place.fault(error.to_string()))?;
    Ok((
        graph::Node {
            name,
            seed,
            also: Vec::new(),
            stage: stage.clone().into_stage(),
            params,
            wires,
        },
        place,
    ))
}
