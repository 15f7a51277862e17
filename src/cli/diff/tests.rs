//! Results whose inputs are gone back through.

use artifacts_schema::ArtifactKind;

use super::*;
use crate::store::manifest::Manifest;
use crate::store::record::Output;

/// A result of the stage `name`, which reads these artifacts and has one.
fn result(store: &Store, name: &str, reads: &[Digest], has: Digest) -> Record {
    let input = |(at, digest): (usize, &Digest)| (format!("inputs.{at}"), digest.to_string());
    let name_entry = ("params.name".to_owned(), name.to_owned());
    let inputs = reads.iter().enumerate().map(input);
    let manifest = Manifest(inputs.chain([name_entry]).collect());
    store.manifests.put(&manifest.key(), &manifest).unwrap();
    let output = Output {
        kind: ArtifactKind::Metrics,
        digest: has,
        files: Vec::new(),
    };
    Record {
        key: manifest.key(),
        stage: name.to_owned(),
        outputs: [("out".to_owned(), output)].into(),
        seconds: 1.0,
        device: "cpu".to_owned(),
        remarks: Vec::new(),
        peak_memory: None,
    }
}

/// Without remembering where it has been, it would go two to the power of a hundred ways here,
/// and in the end round and round.
#[test]
fn whatever_many_rounds_read_of_each_other_each_result_is_visited_once() {
    let digest = |round: usize| Digest::from(blake3::hash(&round.to_le_bytes()));
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    let round = |round: usize| {
        let reads = [digest(round - 1), digest(round - 1)];
        result(&store, &format!("loop.{round}.sync"), &reads, digest(round))
    };
    // The first changes nothing of what it reads.
    let first = result(&store, "fit", &[digest(0)], digest(0));
    let records: Vec<Record> = std::iter::once(first).chain((1..=100).map(round)).collect();
    let made = |record: &Record| (record.outputs["out"].digest.to_string(), record.key);
    let last = records.last().unwrap().key;
    let known = Known {
        made: records.iter().map(made).collect(),
        records: records
            .into_iter()
            .map(|record| (record.key, record))
            .collect(),
        runs: Vec::new(),
        store,
    };
    let side = known.result(last);
    assert_eq!(side.stages.len(), 101);
    assert_eq!(side.stages["fit"].from["0"], "fit");
}
