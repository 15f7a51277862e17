//! What a stage leaves, whichever way it ends.

use std::fs;
use std::time::Duration;

use artifacts_schema::ArtifactKind;

use super::Work;
use crate::store::leases::LeaseTimeouts;
use crate::store::leases::holder::Holder;
use crate::store::results::Lookup;
use crate::store::testing::{blob, commit, facts, key, lookup};
use crate::store::{Store, World};

#[test]
fn a_committed_result_is_found_and_leaves_no_work_behind() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    assert!(matches!(lookup(folder.path(), key("k")), Lookup::Absent));
    let record = commit(&store, key("k"), 1.0, "s");
    assert!(matches!(lookup(folder.path(), key("k")), Lookup::Sound(found) if found == record));
    assert_eq!(fs::read_dir(folder.path().join("work")).unwrap().count(), 0);
    assert_eq!(fs::read_dir(folder.path().join("tmp")).unwrap().count(), 0);
    assert!(
        fs::metadata(blob(&store, &record))
            .unwrap()
            .permissions()
            .readonly()
    );
}

#[test]
fn equal_content_has_equal_digests_whatever_its_origin() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    let a = commit(&store, key("a"), 1.0, "one");
    let b = commit(&store, key("b"), 1.0, "two");
    assert_eq!(a.outputs["m"].digest, b.outputs["m"].digest);
    assert_ne!(a.outputs["m"].files[0].blob, b.outputs["m"].files[0].blob);
}

/// Killed at any point, a run leaves a prefix of the steps of a commit: each prefix is no result,
/// and none is in the way.
#[test]
fn whatever_a_killed_run_leaves_is_no_result_and_not_in_the_way() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    let lasting = folder.path().join("work").join(key("k").to_string());
    for step in 0..4 {
        fs::create_dir_all(lasting.join("run-1/out/m")).unwrap();
        fs::write(lasting.join("run-1/out/m/metrics.json"), "{ half").unwrap();
        fs::create_dir_all(lasting.join("scratch")).unwrap();
        fs::write(lasting.join("scratch/checkpoint"), "7").unwrap();
        if step > 0 {
            fs::write(folder.path().join("tmp/.tmpAbCdEf"), "{ half a record").unwrap();
        }
        if step > 1 {
            // A blob without a record.
            let orphan = folder.path().join("work/orphan");
            fs::write(&orphan, "orphan").unwrap();
            store.blobs.take(&orphan).unwrap();
        }
        assert!(matches!(lookup(folder.path(), key("k")), Lookup::Absent));
        let work = Work::begin(&store, key("k")).unwrap().unwrap();
        assert!(!lasting.join("run-1").exists());
        assert_eq!(fs::read_dir(work.outputs()).unwrap().count(), 0);
        assert_eq!(
            fs::read_to_string(work.scratch().join("checkpoint")).unwrap(),
            "7"
        );
        drop(work);
    }
    commit(&store, key("k"), 1.0, "s");
    assert!(!lasting.exists());
}

/// Whoever sleeps through its lease in the middle of a commit wakes up to a folder that is
/// another's.
#[test]
fn a_commit_takes_nothing_from_the_process_that_took_the_key_over() {
    let folder = tempfile::tempdir().unwrap();
    let impatient = || {
        let lease_timeouts = LeaseTimeouts {
            beat: Duration::from_secs(3600),
            stale: Duration::ZERO,
        };
        let world = World {
            lease_timeouts,
            ..World::default()
        };
        Store::create_in(world, folder.path()).unwrap()
    };
    let [a, b] = [impatient(), impatient()];
    let asleep = Work::begin(&a, key("k")).unwrap().unwrap();
    let awake = Work::begin(&b, key("k")).unwrap().unwrap();
    fs::write(awake.scratch().join("checkpoint"), "7").unwrap();
    asleep.commit(&[], facts("s"), false).unwrap();
    assert!(awake.outputs().is_dir());
    let checkpoint = fs::read_to_string(awake.scratch().join("checkpoint"));
    assert_eq!(checkpoint.unwrap(), "7");
}

#[test]
fn one_key_is_computed_by_one_process_at_a_time_and_the_first_result_stays() {
    let folder = tempfile::tempdir().unwrap();
    let a = Store::create(folder.path()).unwrap();
    let b = Store::create(folder.path()).unwrap();
    let held = Work::begin(&a, key("k")).unwrap().unwrap();
    assert!(
        Work::begin(&b, key("k"))
            .unwrap()
            .is_err_and(|holder| holder == *Holder::this_process())
    );
    assert!(Work::begin(&b, key("other")).unwrap().is_ok());
    held.abandon().unwrap();
    let first = commit(&b, key("k"), 1.0, "first");
    assert_eq!(commit(&a, key("k"), 2.0, "second"), first);
}

#[test]
fn an_output_that_was_not_written_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    let work = Work::begin(&store, key("k")).unwrap().unwrap();
    let error = work
        .commit(&[("m", ArtifactKind::Metrics)], facts("s"), false)
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("the stage's output `m` cannot be kept"),
        "{error}"
    );
    assert!(matches!(lookup(folder.path(), key("k")), Lookup::Absent));
}
