//! `diff`: compares two runs, two results or two pipelines, and names what differs by itself.
//! Writes nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use artifacts_schema::Digest;
use clap::Args;
use serde_json::{Value, json};

use super::error::Error;
use super::options::{Changes, Choice};
use super::session::Session;
use crate::runner::diff::{Part, Side, Verdict, Which, compare};
use crate::store::Store;
use crate::store::record::Record;
use crate::store::runs::RunRecord;
use crate::terminal::output::{print, print_json, table};

#[derive(Args)]
pub struct Diff {
    /// A run (@2 is the last but one; or 20261122T23), a key or its beginning, or a pipeline file
    a: Option<String>,
    /// The other side; with --set, the same pipeline with these overrides; else the last run
    b: Option<String>,
    #[command(flatten)]
    changes: Changes,
    /// Exit with 5 if anything differs
    #[arg(long)]
    exit_code: bool,
}

/// What the store knows.
struct Known {
    store: Store,
    runs: Vec<RunRecord>,
    records: BTreeMap<Digest, Record>,
    /// The key of a result that has this artifact.
    made: BTreeMap<String, Digest>,
}

impl Diff {
    /// Prints the comparison.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let known = Known::new(Store::open(&self.changes.folders.store)?)?;
        // Overrides are of the second side, so that a pipeline can be compared with itself changed.
        let plain = Changes {
            set: Vec::new(),
            ..self.changes.clone()
        };
        let (a, b) = self.sides();
        let a = known.side(a, &plain)?;
        let b = known.side(b, &self.changes)?;
        let verdicts = compare(&a, &b);
        if json {
            let stages: Vec<Value> = verdicts
                .iter()
                .map(|(name, verdict)| entry(name, verdict))
                .collect();
            print_json(&json!({"a": a.title, "b": b.title, "stages": stages}));
        } else {
            tell(&a, &b, &verdicts);
        }
        let differ = verdicts
            .values()
            .filter(|verdict| **verdict != Verdict::Same)
            .count();
        if self.exit_code && differ > 0 {
            return Err(Error::Found {
                message: format!("{differ} of {} stages differ", verdicts.len()),
                help: None,
            });
        }
        Ok(())
    }
}

impl Diff {
    /// What is compared with what: by default the last run but one with the last, a pipeline's last
    /// run with the pipeline as it is now, and anything else with the last run.
    fn sides(&self) -> (&str, &str) {
        match (self.a.as_deref(), self.b.as_deref()) {
            (None, _) => ("@2", "@1"),
            (Some(a), Some(b)) => (a, b),
            (Some(a), None) if !self.changes.set.is_empty() => (a, a),
            // The run first, so that changes read from what was to what is.
            (Some(pipeline), None) if pipeline.ends_with(".ron") => ("@1", pipeline),
            (Some(a), None) => (a, "@1"),
        }
    }
}

impl Known {
    fn new(store: Store) -> Result<Self, Error> {
        let records: BTreeMap<Digest, Record> = store
            .results
            .records()?
            .into_iter()
            .map(|record| (record.key, record))
            .collect();
        let outputs = |record: &Record| {
            record
                .outputs
                .values()
                .map(|output| output.digest)
                .collect::<Vec<_>>()
        };
        let made = records
            .values()
            .flat_map(|record| {
                outputs(record)
                    .into_iter()
                    .map(|digest| (digest.to_string(), record.key))
            })
            .collect();
        let runs = RunRecord::past(&store, None)?.collect();
        Ok(Self {
            store,
            runs,
            records,
            made,
        })
    }

    fn side(&self, word: &str, changes: &Changes) -> Result<Side, Error> {
        // A .ron that is not there goes this way too, so that the error speaks of a file and not of
        // a run.
        if Path::new(word).is_file() || word.ends_with(".ron") {
            return self.pipeline(Path::new(word), changes);
        }
        if let Some(run) = find_run(&self.runs, word) {
            return Ok(self.run(run));
        }
        match self.find_key(word)? {
            Some(key) => Ok(self.result(key)),
            None => Err(Error::usage(
                format!("`{word}` is no run, no key and no pipeline file"),
                "the last run is @1, the one before it @2; a key may be shortened to its first 6 digits",
            )),
        }
    }

    fn find_key(&self, word: &str) -> Result<Option<Digest>, Error> {
        let keys: Vec<Digest> = self.store.manifests.keys_like(word)?;
        match keys[..] {
            [] => Ok(None),
            [key] => Ok(Some(key)),
            _ => Err(Error::usage(
                format!("`{word}` is the beginning of {} keys", keys.len()),
                "give more digits",
            )),
        }
    }

    fn pipeline(&self, path: &Path, changes: &Changes) -> Result<Side, Error> {
        let session = Session::new(path, changes, &Choice::default())?;
        let context = session.context(&self.store);
        let forecasts = context.forecast()?;
        let nodes = &session.graph.nodes;
        let stages = context
            .manifests(&forecasts)
            .into_iter()
            .map(|(at, manifest)| {
                let from = nodes[at]
                    .wires
                    .iter()
                    .map(|wire| (wire.input.clone(), nodes[wire.from].name.clone()));
                (
                    nodes[at].name.clone(),
                    Part {
                        manifest,
                        from: from.collect(),
                    },
                )
            });
        let title = std::iter::once(path.display().to_string()).chain(changes.set.iter().cloned());
        Ok(Side {
            title: title.collect::<Vec<_>>().join(" "),
            stages: stages.collect(),
        })
    }

    fn run(&self, run: &RunRecord) -> Side {
        let names: BTreeMap<Digest, &String> = run
            .stages
            .iter()
            .filter_map(|(name, stage)| Some((stage.key?, name)))
            .collect();
        let stages = names.iter().filter_map(|(key, name)| {
            let part = self.part(key, |from| names.get(from).map(|name| (*name).clone()))?;
            Some(((*name).clone(), part))
        });
        Side {
            title: format!("the run of {} at {}", run.pipeline, run.started),
            stages: stages.collect(),
        }
    }

    /// A result and all that it came from, each by the name of its stage.
    fn result(&self, key: Digest) -> Side {
        let name = |key: &Digest| self.records.get(key).map(|record| record.stage.clone());
        let mut stages = BTreeMap::new();
        let mut seen = BTreeSet::new();
        let mut todo = vec![key];
        while let Some(at) = todo.pop() {
            // Once each: in a loop there are twice as many ways to a round as to the one after it,
            // and a result that equals one of its own inputs is made of itself, as far as digests
            // tell.
            let Some(part) = seen.insert(at).then(|| self.part(&at, name)).flatten() else {
                continue;
            };
            let inputs = part
                .manifest
                .0
                .iter()
                .filter(|(path, _)| path.starts_with("inputs."));
            todo.extend(inputs.filter_map(|(_, digest)| self.made.get(digest)));
            stages.insert(
                // Sides are compared name by name. The two results themselves need one name,
                // whatever their stages are called.
                if at == key {
                    "the result".to_owned()
                } else {
                    name(&at).unwrap_or_default()
                },
                part,
            );
        }
        Side {
            title: format!("the result {}", &key.to_string()[..12]),
            stages,
        }
    }

    fn part(&self, key: &Digest, name: impl Fn(&Digest) -> Option<String>) -> Option<Part> {
        let manifest = self.store.manifests.get(key)?;
        let from = manifest.0.iter().filter_map(|(path, digest)| {
            Some((
                path.strip_prefix("inputs.")?.to_owned(),
                name(self.made.get(digest)?)?,
            ))
        });
        let from = from.collect();
        Some(Part { manifest, from })
    }
}

/// The run that a word means, of runs from the newest on: `@2` is the second newest of the newest
/// one's pipeline, and the beginning of a moment the newest run of that moment.
pub(super) fn find_run<'r>(runs: &'r [RunRecord], word: &str) -> Option<&'r RunRecord> {
    match word.strip_prefix('@').map(str::parse::<usize>) {
        Some(Ok(number)) => {
            let newest = &runs.first()?.pipeline;
            runs.iter()
                .filter(|run| run.pipeline == *newest)
                // `@0` names no run, and must not wrap around.
                .nth(number.checked_sub(1)?)
        }
        Some(Err(_)) => None,
        None => runs
            .iter()
            // A whole date at least, so that a few digits mean a key.
            .find(|run| word.len() >= 8 && run.started.starts_with(word)),
    }
}

fn entry(name: &str, verdict: &Verdict) -> Value {
    match verdict {
        Verdict::Same => json!({"stage": name, "state": "same"}),
        Verdict::Differs(changes) => json!({"stage": name, "state": "differs", "changes": changes}),
        Verdict::Follows(causes) => json!({"stage": name, "state": "follows", "causes": causes}),
        Verdict::Only(Which::A) => json!({"stage": name, "state": "only_in_a"}),
        Verdict::Only(Which::B) => json!({"stage": name, "state": "only_in_b"}),
    }
}

fn tell(a: &Side, b: &Side, verdicts: &BTreeMap<String, Verdict>) {
    print(&format_args!("A: {}\nB: {}\n", a.title, b.title));
    let rank = |verdict: &Verdict| matches!(verdict, Verdict::Follows(_));
    let mut different: Vec<_> = verdicts
        .iter()
        .filter(|(_, verdict)| **verdict != Verdict::Same)
        .collect();
    // What differs by itself comes first, since the rest follows from it.
    different.sort_by_key(|(_, verdict)| rank(verdict));
    let rows: Vec<Vec<String>> = different
        .iter()
        .map(|(name, verdict)| vec![(*name).clone(), words(verdict)])
        .collect();
    if !rows.is_empty() {
        print(&format_args!("{}\n", table(&rows, false)));
    }
    let follow = different
        .iter()
        .filter(|(_, verdict)| rank(verdict))
        .count();
    let by_itself = different.len() - follow;
    print(&format_args!(
        "{} stages: {by_itself} differ by themselves, {follow} follow",
        verdicts.len()
    ));
}

fn words(verdict: &Verdict) -> String {
    match verdict {
        Verdict::Same => "same".into(),
        Verdict::Differs(changes) => changes
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join(", "),
        Verdict::Follows(causes) => format!(
            "follows {}",
            causes.iter().cloned().collect::<Vec<_>>().join(", ")
        ),
        Verdict::Only(Which::A) => "only in A".into(),
        Verdict::Only(Which::B) => "only in B".into(),
    }
}

#[cfg(test)]
mod tests;
