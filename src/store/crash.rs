//! The store's invariants on a machine that stops after any file operation, on a full disk, and on
//! one that cannot be written.

use std::path::Path;
use std::time::Duration;

use artifacts_schema::{Artifact, ArtifactKind, Digest, Provenance};
use proptest::prelude::*;

use super::error::StoreError;
use super::files::disk::{Disk, DiskFault};
use super::fsck::look_through;
use super::leases::LeaseTimeouts;
use super::record::Record;
use super::results::Lookup;
use super::runs::{RunRecord, now};
use super::testing::{facts, key, metrics};
use super::work::Work;
use super::{Store, World};

/// More operations than a life has.
const ENOUGH: usize = 1000;

/// A store on this disk. Those who died in it are known to be dead.
fn store(disk: Disk, root: &Path) -> Result<Store, StoreError> {
    let lease_timeouts = LeaseTimeouts {
        beat: Duration::from_secs(3600),
        stale: Duration::ZERO,
    };
    let world = World {
        disk,
        lease_timeouts,
        ..World::default()
    };
    Store::create_in(world, root)
}

fn commit(store: &Store, key: Digest, value: f64, replace: bool) -> Result<Record, StoreError> {
    let work = Work::begin(store, key)?.unwrap_or_else(|holder| panic!("{holder} has the key"));
    metrics(value)
        .write(&work.outputs().join("m"), &Provenance::default())
        .unwrap();
    work.commit(&[("m", ArtifactKind::Metrics)], facts("s"), replace)
}

/// What a run does to a store.
fn life(disk: Disk, root: &Path) -> Result<Record, StoreError> {
    let store = store(disk, root)?;
    store.manifests.put(&key("k"), &Default::default())?;
    let record = commit(&store, key("k"), 1.0, false)?;
    let run = RunRecord {
        pipeline: "p".into(),
        started: now(),
        seconds: 1.0,
        stages: Default::default(),
        experiment: None,
        command: None,
    };
    run.keep(&store)?;
    Ok(record)
}

fn lookup(root: &Path, key: Digest) -> Lookup {
    Store::open(root).unwrap().results.lookup(&key).unwrap()
}

/// The names of the operations of a life.
fn operations() -> Vec<(String, std::path::PathBuf)> {
    let folder = tempfile::tempdir().unwrap();
    let fault = DiskFault::crash(ENOUGH);
    let done = fault.done();
    life(Disk::failing(fault), folder.path()).unwrap();
    let done = done.lock().unwrap();
    done.clone()
}

/// A life that is cut short by a fault leaves a whole result or none, and the next life is like any
/// other.
fn cut_short(fault: fn(usize) -> DiskFault) -> Vec<String> {
    let calm = life(Disk::default(), tempfile::tempdir().unwrap().path()).unwrap();
    let count = operations().len();
    let mut errors = Vec::new();
    for after in 0..=count {
        let folder = tempfile::tempdir().unwrap();
        let done = life(Disk::failing(fault(after)), folder.path());
        match (lookup(folder.path(), key("k")), &done) {
            (Lookup::Sound(found), _) => {
                assert_eq!(found.outputs, calm.outputs, "after {after} operations")
            }
            (Lookup::Absent, Err(_)) => {}
            (found, done) => panic!("after {after} operations: {found:?}, {done:?}"),
        }
        errors.extend(
            done.err()
                .map(|error| format!("{:?}", miette::Report::new(error))),
        );
        let again = life(Disk::default(), folder.path()).unwrap();
        assert_eq!(again.outputs, calm.outputs, "after {after} operations");
        for left in ["work", "leases"] {
            let left: Vec<_> = std::fs::read_dir(folder.path().join(left))
                .unwrap()
                .collect();
            assert!(left.is_empty(), "after {after} operations: {left:?}");
        }
    }
    errors
}

#[test]
fn a_commit_is_whole_or_not_there_wherever_the_machine_stops() {
    let errors = cut_short(DiskFault::crash);
    assert_eq!(errors.len(), operations().len());
}

#[test]
fn a_full_disk_is_said_to_be_full_and_nothing_is_lost() {
    let errors = cut_short(DiskFault::full);
    assert!(errors.len() > 10);
    errors.iter().for_each(|error| {
        assert!(
            error.contains("the disk is full: free some space"),
            "{error}"
        )
    });
}

#[test]
fn a_store_that_cannot_be_written_is_said_to_be_so_and_nothing_is_lost() {
    let errors = cut_short(DiskFault::read_only);
    errors.iter().for_each(|error| {
        assert!(
            error.contains("choose a folder that can be written"),
            "{error}"
        )
    });
}

/// After a loss of power a name may be there and what it names may not, unless what it names was
/// flushed before.
#[test]
fn whatever_gets_its_name_was_flushed_before_and_a_record_comes_after_its_blobs() {
    let done = operations();
    let flushed = |path: &Path, by: usize| {
        done[..by]
            .iter()
            .any(|(what, at)| what == "flush" && at == path)
    };
    let renames: Vec<usize> = (0..done.len())
        .filter(|&at| done[at].0 == "rename")
        .collect();
    assert!(renames.len() >= 5);
    renames
        .iter()
        .for_each(|&at| assert!(flushed(&done[at].1, at), "{:?} was not flushed", done[at].1));
    let blob = renames
        .iter()
        .find(|&&at| done[at].1.ends_with("out/m/metrics.json"))
        .copied()
        .unwrap();
    let folder = |at: usize| {
        done[at].0 == "flush"
            && done[at]
                .1
                .parent()
                .is_some_and(|path| path.ends_with("cas"))
    };
    let named = (blob..done.len()).find(|&at| folder(at)).unwrap();
    let record = renames.iter().filter(|&&at| at > blob).min().unwrap();
    assert!(
        named < *record,
        "the record is visible before its blobs are safe"
    );
    let fanned = |folder: &Path| {
        let above = folder.parent().and_then(Path::file_name);
        above.is_some_and(|name| {
            ["cas", "results", "manifests"]
                .iter()
                .any(|fan| name == *fan)
        })
    };
    let made = (0..done.len()).filter(|&at| done[at].0 == "create" && fanned(&done[at].1));
    let next: Vec<_> = made.map(|at| (&done[at].1, &done[at + 1])).collect();
    assert_eq!(next.len(), 3);
    for (folder, (what, at)) in next {
        assert!(
            what == "flush" && at == folder.parent().unwrap(),
            "{folder:?} is gone with all that is in it"
        );
    }
}

#[test]
fn a_blob_that_fsck_puts_in_its_place_stays_there() {
    let folder = tempfile::tempdir().unwrap();
    let record = life(Disk::default(), folder.path()).unwrap();
    let fault = DiskFault::crash(ENOUGH);
    let done = fault.done();
    let store = store(Disk::failing(fault), folder.path()).unwrap();
    let blob = store.blobs.path(&record.files().next().unwrap().1.blob);
    let elsewhere = store.blobs.path(&key("elsewhere"));
    std::fs::create_dir_all(elsewhere.parent().unwrap()).unwrap();
    std::fs::rename(&blob, &elsewhere).unwrap();
    let out = folder.path().join("out");
    assert_eq!(look_through(&store, &out, true).unwrap().results, 1);
    let done = done.lock().unwrap();
    let moved = done
        .iter()
        .position(|(what, at)| what == "rename" && *at == elsewhere);
    let flushed = done
        .iter()
        .rposition(|(what, at)| what == "flush" && at == blob.parent().unwrap());
    assert!(moved.unwrap() < flushed.expect("a flush"));
}

/// Something that a run may do to one of a few keys.
#[derive(Clone, Debug)]
enum Act {
    Commit(u8),
    Force(u8),
    Damage(u8),
}

fn acts() -> impl Strategy<Value = Vec<Act>> {
    let act = (0u8..3, 0u8..3).prop_map(|(act, key)| match act {
        0 => Act::Commit(key),
        1 => Act::Force(key),
        _ => Act::Damage(key),
    });
    prop::collection::vec(act, 1..7)
}

/// Does all of it, and returns which keys have a result. The value of a key is the key.
fn act_all(store: &Store, acts: &[Act], known: &mut [bool; 3]) -> Result<(), StoreError> {
    for act in acts {
        let (Act::Commit(at) | Act::Force(at) | Act::Damage(at)) = *act;
        let key = key(&at.to_string());
        if let (Act::Damage(_), Lookup::Sound(record)) = (act, store.results.lookup(&key)?) {
            let (_, file) = record.files().next().unwrap();
            let breakage = super::results::Breakage::Blob {
                file: "m".into(),
                blob: file.blob,
                damage: super::blobs::Damage::Changed,
            };
            known[usize::from(at)] = false;
            store.results.discard(&key, &breakage)?;
        } else {
            commit(store, key, at.into(), matches!(act, Act::Force(_)))?;
            known[usize::from(at)] = true;
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases / 16))]

    #[test]
    fn what_was_committed_stays_and_what_was_not_is_whole_or_absent(acts in acts(), after in 0usize..160) {
        let folder = tempfile::tempdir().unwrap();
        let mut known = [false; 3];
        if let Ok(store) = store(Disk::failing(DiskFault::crash(after)), folder.path()) {
            // The error, if any, is the end of the world, which was expected.
            let _ = act_all(&store, &acts, &mut known);
        }
        for at in 0..3u8 {
            let found = lookup(folder.path(), key(&at.to_string()));
            let right = match &found {
                Lookup::Sound(_) => true,
                Lookup::Absent => !known[usize::from(at)],
                Lookup::Broken(_) => false,
            };
            prop_assert!(right, "{at}: {found:?}");
        }
        let after = store(Disk::default(), folder.path()).unwrap();
        for at in 0..3u8 {
            let record = commit(&after, key(&at.to_string()), at.into(), false).unwrap();
            prop_assert!(matches!(lookup(folder.path(), record.key), Lookup::Sound(found) if found.outputs == record.outputs));
        }
    }
}
