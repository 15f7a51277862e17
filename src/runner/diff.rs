//! Two runs, two recipes or two pipelines compared stage by stage: which differ by themselves, and
//! which only follow.
//!
//! Knows nothing of where the two sides come from.

use std::collections::{BTreeMap, BTreeSet};

use crate::runner::explain::{Change, diff};
use crate::store::manifest::Manifest;

/// One side: its stages by name.
#[derive(Debug, Default)]
pub struct Side {
    /// What it is, in words.
    pub title: String,
    pub stages: BTreeMap<String, Part>,
}

/// A stage of one side.
#[derive(Clone, Debug)]
pub struct Part {
    /// What is in the key; inputs that are not known yet are left out.
    pub manifest: Manifest,
    /// The stage that each input comes from, as far as that is known.
    pub from: BTreeMap<String, String>,
}

/// What tells a stage of the one side from that of the other.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Nothing.
    Same,
    /// It differs by itself.
    Differs(Vec<Change>),
    /// Only its inputs differ, because of these stages.
    Follows(BTreeSet<String>),
    /// There is none on the other side.
    Only(Which),
}

/// One of two sides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// The first.
    A,
    /// The second.
    B,
}

/// Compares all stages.
pub fn compare(a: &Side, b: &Side) -> BTreeMap<String, Verdict> {
    let mut verdicts = BTreeMap::new();
    // Names of both sides come twice. The second time their verdict is there.
    for name in a.stages.keys().chain(b.stages.keys()) {
        decide(name, a, b, &mut verdicts);
    }
    verdicts
}

/// Finds a stage's verdict, and before it those of all stages that it reads on both sides.
fn decide(name: &str, a: &Side, b: &Side, verdicts: &mut BTreeMap<String, Verdict>) {
    // A stack of our own: pipelines may be deeper than the thread's.
    let mut stack = vec![name.to_owned()];
    // Names can read each other in a circle: results of several runs and pipelines lie behind one
    // key, and each has the name that its first run gave it. Who comes back to a name goes without
    // its verdict.
    let mut begun = BTreeSet::new();
    while let Some(name) = stack.last().cloned() {
        let missing = match (a.stages.get(&name), b.stages.get(&name)) {
            (Some(_), Some(part)) if begun.insert(name.clone()) => part
                .from
                .values()
                .filter(|from| b.stages.contains_key(*from))
                .filter(|from| !verdicts.contains_key(*from) && !begun.contains(*from))
                .cloned()
                .collect(),
            _ => Vec::new(),
        };
        if missing.is_empty() {
            stack.pop();
            if !verdicts.contains_key(&name) {
                let verdict = verdict(&name, a, b, verdicts);
                verdicts.insert(name, verdict);
            }
        }
        stack.extend(missing);
    }
}

fn verdict(name: &str, a: &Side, b: &Side, upstream: &BTreeMap<String, Verdict>) -> Verdict {
    let (before, now) = match (a.stages.get(name), b.stages.get(name)) {
        (Some(before), Some(now)) => (before, now),
        (Some(_), None) => return Verdict::Only(Which::A),
        (None, _) => return Verdict::Only(Which::B),
    };
    let is_input = |change: &Change| change.input().is_some();
    let (changed, mut own): (Vec<Change>, Vec<Change>) =
        diff(&before.manifest, &now.manifest, &BTreeSet::new())
            .into_iter()
            .partition(is_input);
    let inputs = before
        .from
        .keys()
        .chain(now.from.keys())
        .map(String::as_str);
    let inputs: BTreeSet<&str> = inputs
        .chain(changed.iter().filter_map(Change::input))
        .collect();
    let mut causes = BTreeSet::new();
    for input in inputs {
        let was = before.from.get(input);
        let is = now.from.get(input);
        let known = |part: &Part| part.manifest.0.get(&format!("inputs.{input}")).cloned();
        let digest_was = known(before);
        let digest_is = known(now);
        let differ = digest_was.is_some() && digest_is.is_some() && digest_was != digest_is;
        // Of a pipeline that has not run, digests are unknown: then what differs upstream is taken
        // to reach this stage.
        let unknown = digest_was.is_none() || digest_is.is_none();
        match is.and_then(|is| upstream.get(is)) {
            // Only stages that differ by themselves are named as causes, not those in between that
            // follow too.
            Some(Verdict::Follows(further)) if was == is && (differ || unknown) => {
                causes.extend(further.clone())
            }
            Some(Verdict::Differs(_)) if was == is && (differ || unknown) => {
                causes.extend(is.cloned())
            }
            // Wired otherwise, or other content without a cause upstream: that is a difference of
            // its own.
            _ if was != is || differ => own.push(change(
                input,
                was.or(digest_was.as_ref()),
                is.or(digest_is.as_ref()),
            )),
            _ => {}
        }
    }
    match (own.is_empty(), causes.is_empty()) {
        (false, _) => Verdict::Differs(own),
        (true, false) => Verdict::Follows(causes),
        (true, true) => Verdict::Same,
    }
}

/// An input that comes from another stage, or has another content for no reason that is known.
fn change(input: &str, was: Option<&String>, is: Option<&String>) -> Change {
    Change {
        path: format!("reads.{input}"),
        before: was.cloned(),
        now: is.cloned(),
        from: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sides as text: `name(param) <- from` for each stage, its input's digest unknown.
    fn side(stages: &[(&str, &str, &[&str])]) -> Side {
        let part = |param: &str, from: &[&str]| Part {
            manifest: Manifest([("params.p".to_owned(), param.to_owned())].into()),
            from: from
                .iter()
                .map(|from| (format!("from_{from}"), (*from).to_owned()))
                .collect(),
        };
        let stages = stages
            .iter()
            .map(|(name, param, from)| ((*name).to_owned(), part(param, from)))
            .collect();
        Side {
            title: String::new(),
            stages,
        }
    }

    #[test]
    fn stages_differ_follow_or_stay() {
        let a = side(&[
            ("a", "1", &[]),
            ("b", "1", &["a"]),
            ("c", "1", &["b"]),
            ("d", "1", &[]),
            ("gone", "1", &[]),
        ]);
        let b = side(&[
            ("a", "2", &[]),
            ("b", "1", &["a"]),
            ("c", "1", &["b"]),
            ("d", "1", &[]),
            ("new", "1", &[]),
        ]);
        let verdicts = compare(&a, &b);
        assert!(
            matches!(&verdicts["a"], Verdict::Differs(changes) if changes[0].path == "params.p")
        );
        assert_eq!(verdicts["b"], Verdict::Follows(["a".to_owned()].into()));
        assert_eq!(verdicts["c"], Verdict::Follows(["a".to_owned()].into()));
        assert_eq!(verdicts["d"], Verdict::Same);
        assert_eq!(
            (&verdicts["gone"], &verdicts["new"]),
            (&Verdict::Only(Which::A), &Verdict::Only(Which::B))
        );
    }

    #[test]
    fn an_equal_result_ends_the_difference() {
        let mut a = side(&[("a", "1", &[]), ("b", "1", &["a"])]);
        let mut b = side(&[("a", "2", &[]), ("b", "1", &["a"])]);
        for side in [&mut a, &mut b] {
            let Manifest(entries) = &mut side.stages.get_mut("b").unwrap().manifest;
            entries.insert("inputs.from_a".into(), "the same".into());
        }
        assert_eq!(compare(&a, &b)["b"], Verdict::Same);
    }

    #[test]
    fn reading_another_stage_is_a_difference_of_its_own() {
        let a = side(&[("a", "1", &[]), ("b", "1", &[]), ("c", "1", &["a"])]);
        let mut b = side(&[("a", "1", &[]), ("b", "1", &[]), ("c", "1", &[])]);
        b.stages.get_mut("c").unwrap().from = [("from_a".to_owned(), "b".to_owned())].into();
        let Verdict::Differs(changes) = &compare(&a, &b)["c"] else {
            panic!()
        };
        assert_eq!(
            (changes[0].before.as_deref(), changes[0].now.as_deref()),
            (Some("a"), Some("b"))
        );
    }

    #[test]
    fn names_that_read_each_other_in_a_circle_are_compared() {
        let circle =
            |param: &str| side(&[("a", param, &["b"]), ("b", "1", &["c"]), ("c", "1", &["a"])]);
        let verdicts = compare(&circle("1"), &circle("2"));
        assert!(matches!(verdicts["a"], Verdict::Differs(_)) && verdicts.len() == 3);
    }

    #[test]
    fn chains_deeper_than_a_stack_are_compared() {
        let names: Vec<String> = (0..100_000).map(|at| format!("s{at:06}")).collect();
        let chain = |param: &str| {
            let mut all = side(&[]);
            for (at, name) in names.iter().enumerate().rev() {
                let from: Vec<&str> = names.get(at + 1).map(String::as_str).into_iter().collect();
                let param = if from.is_empty() { param } else { "x" };
                all.stages.extend(side(&[(name, param, &from)]).stages);
            }
            all
        };
        let verdicts = compare(&chain("1"), &chain("2"));
        assert!(verdicts.values().all(|verdict| *verdict != Verdict::Same));
    }
}
