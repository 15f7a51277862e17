//! What the store promises, whatever happens to it.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use artifacts_schema::{Artifact, ArtifactKind, Digest, Metrics, Provenance, Row};

use super::blobs::Damage;
use super::cache::clock::Clock;
use super::cache::index::Kind;
use super::cache::signature::Signature;
use super::leases::Patience;
use super::leases::holder::Holder;
use super::record::Record;
use super::results::{Breakage, Lookup};
use super::runs::{Run, now};
use super::view::View;
use super::work::Facts;
use super::{Store, World};

pub fn key(text: &str) -> Digest {
    blake3::hash(text.as_bytes()).into()
}

pub fn metrics(value: f64) -> Metrics {
    let row = Row {
        mean: [("value".to_owned(), value)].into(),
        views: Default::default(),
    };
    Metrics {
        rows: [("row".to_owned(), row)].into(),
        definitions: Default::default(),
        absent: Default::default(),
    }
}

fn commit(store: &Store, key: Digest, value: f64, stage: &str) -> Record {
    let work = store.work(key).unwrap().unwrap();
    let provenance = Provenance {
        stage: stage.into(),
        ..Provenance::default()
    };
    metrics(value)
        .write(&work.outputs().join("m"), &provenance)
        .unwrap();
    work.commit(&[("m", ArtifactKind::Metrics)], facts(stage), false)
        .unwrap()
}

fn facts(stage: &str) -> Facts {
    Facts {
        stage: stage.into(),
        seconds: 1.0,
        device: "cpu".into(),
        remarks: Vec::new(),
        peak_memory: None,
    }
}

fn blob(store: &Store, record: &Record) -> PathBuf {
    store.blobs.path(&record.outputs["m"].files[0].blob)
}

/// Damage is looked for once in a process: a new store is a new process.
fn lookup(folder: &Path, key: Digest) -> Lookup {
    Store::open(folder).unwrap().results.lookup(&key).unwrap()
}

fn overwrite(path: &Path, bytes: &[u8]) {
    fs::remove_file(path).unwrap();
    fs::write(path, bytes).unwrap();
}

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

/// Its own results need not be read through by the next process; but not what changed since it
/// wrote them, or may have.
#[test]
fn a_process_vouches_for_what_it_has_written_and_is_still_so() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    let [old, damaged] =
        [("old", 1.0), ("damaged", 2.0)].map(|(name, value)| commit(&store, key(name), value, "s"));
    let path = blob(&store, &damaged);
    let before = Signature::at(&path);
    let other = fs::read(blob(&store, &old)).unwrap();
    // Two changes within one tick of the system's clock look like one.
    while Signature::at(&path) == before {
        overwrite(&path, &other);
    }
    let remembered = |store: &Store| {
        store
            .results
            .known
            .remember_own([&old, &damaged].into_iter());
        store.cache.keep();
        let next = Store::open(folder.path()).unwrap();
        next.cache.index.places(Kind::Result).len()
    };
    assert_eq!(remembered(&store), 0, "both have just been written");
    // A second name is no change.
    fs::hard_link(blob(&store, &old), folder.path().join("shown")).unwrap();
    let later = World {
        clock: Clock {
            ahead: Duration::from_secs(3),
        },
        ..World::default()
    };
    let later = Store::create_in(later, folder.path()).unwrap();
    assert_eq!(remembered(&later), 1, "`damaged` is not what was written");
    assert!(matches!(
        lookup(folder.path(), key("damaged")),
        Lookup::Broken(_)
    ));
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

#[test]
fn every_damage_is_noticed_and_healed_by_computing_again() {
    let folder = tempfile::tempdir().unwrap();
    let first = commit(&Store::create(folder.path()).unwrap(), key("k"), 1.0, "s");
    let flip = |blob: &Path| {
        let mut bytes = fs::read(blob).unwrap();
        bytes[10] ^= 1;
        overwrite(blob, &bytes);
    };
    let acts: [&dyn Fn(&Path); 4] = [
        &|blob| fs::remove_file(blob).unwrap(),
        &|blob| overwrite(blob, b""),
        &|blob| overwrite(blob, b"something else"),
        &flip,
    ];
    for (act, damage) in acts.iter().zip([
        Damage::Missing,
        Damage::Changed,
        Damage::Changed,
        Damage::Changed,
    ]) {
        let store = Store::create(folder.path()).unwrap();
        act(&blob(&store, &first));
        let Lookup::Broken(breakage) = store.results.lookup(&key("k")).unwrap() else {
            panic!("{damage:?} went unnoticed")
        };
        let file = first.outputs["m"].files[0].clone();
        assert_eq!(
            breakage,
            Breakage::Blob {
                file: "m/metrics.json".into(),
                blob: file.blob,
                damage
            }
        );
        store.results.discard(&key("k"), &breakage).unwrap();
        assert!(matches!(lookup(folder.path(), key("k")), Lookup::Absent));
        assert_eq!(commit(&store, key("k"), 1.0, "s").outputs, first.outputs);
        assert!(matches!(lookup(folder.path(), key("k")), Lookup::Sound(_)));
    }
}

#[test]
fn a_record_that_cannot_be_understood_is_no_result() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    let record = commit(&store, key("k"), 1.0, "s");
    let path = store.results.path(&key("k"));
    let mut outside = record.clone();
    outside.outputs.get_mut("m").unwrap().files[0].path = "../../secret".into();
    let swapped = Record {
        key: key("other"),
        ..record
    };
    for text in [
        String::new(),
        "{".into(),
        serde_json::to_string(&outside).unwrap(),
        serde_json::to_string(&swapped).unwrap(),
    ] {
        overwrite(&path, text.as_bytes());
        assert!(
            matches!(
                lookup(folder.path(), key("k")),
                Lookup::Broken(Breakage::Record)
            ),
            "{text}"
        );
    }
    store.results.discard(&key("k"), &Breakage::Record).unwrap();
    assert!(matches!(lookup(folder.path(), key("k")), Lookup::Absent));
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
        let work = store.work(key("k")).unwrap().unwrap();
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

#[test]
fn a_damaged_record_gives_way_to_a_new_result() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    let record = commit(&store, key("k"), 1.0, "s");
    let path = store.results.path(&key("k"));
    let damages: [&dyn Fn(); 2] = [&|| fs::write(&path, "{").unwrap(), &|| {
        fs::create_dir(&path).unwrap()
    }];
    for damage in damages {
        fs::remove_file(&path).unwrap();
        damage();
        assert_eq!(commit(&store, key("k"), 1.0, "s").outputs, record.outputs);
        assert!(matches!(lookup(folder.path(), key("k")), Lookup::Sound(_)));
    }
    let aside = fs::read_dir(folder.path().join("quarantine")).unwrap();
    assert_eq!(aside.count(), 2);
}

/// Whoever sleeps through its lease in the middle of a commit wakes up to a folder that is
/// another's.
#[test]
fn a_commit_takes_nothing_from_the_process_that_took_the_key_over() {
    let folder = tempfile::tempdir().unwrap();
    let impatient = || {
        let patience = Patience {
            beat: Duration::from_secs(3600),
            stale: Duration::ZERO,
        };
        let world = World {
            patience,
            ..World::default()
        };
        Store::create_in(world, folder.path()).unwrap()
    };
    let [a, b] = [impatient(), impatient()];
    let asleep = a.work(key("k")).unwrap().unwrap();
    let awake = b.work(key("k")).unwrap().unwrap();
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
    let held = a.work(key("k")).unwrap().unwrap();
    assert!(
        b.work(key("k"))
            .unwrap()
            .is_err_and(|holder| holder == *Holder::this_process())
    );
    assert!(b.work(key("other")).unwrap().is_ok());
    held.abandon().unwrap();
    let first = commit(&b, key("k"), 1.0, "first");
    assert_eq!(commit(&a, key("k"), 2.0, "second"), first);
}

#[test]
fn an_output_that_was_not_written_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    let work = store.work(key("k")).unwrap().unwrap();
    let facts = Facts {
        stage: "s".into(),
        seconds: 1.0,
        device: "cpu".into(),
        remarks: Vec::new(),
        peak_memory: None,
    };
    let error = work
        .commit(&[("m", ArtifactKind::Metrics)], facts, false)
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("the stage's output `m` cannot be kept"),
        "{error}"
    );
    assert!(matches!(lookup(folder.path(), key("k")), Lookup::Absent));
}

#[test]
fn people_see_what_the_store_has_and_nothing_of_theirs_is_removed() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(&folder.path().join("store")).unwrap();
    let view = View::new(&folder.path().join("out"), "p");
    let shown = view.output("s", "m").join("metrics.json");
    for value in [1.0, 2.0] {
        view.show(
            &store,
            "s",
            &commit(&store, key(&value.to_string()), value, "s"),
        )
        .unwrap();
        assert_eq!(
            Metrics::read(&view.output("s", "m")).unwrap(),
            metrics(value)
        );
    }
    // A copy in place of a link is as good; a changed file is not.
    let record = commit(&store, key("2"), 2.0, "s");
    overwrite(&shown, &fs::read(blob(&store, &record)).unwrap());
    view.show(&store, "s", &record).unwrap();
    overwrite(&shown, b"changed");
    view.show(&store, "s", &record).unwrap();
    assert_eq!(Metrics::read(&view.output("s", "m")).unwrap(), metrics(2.0));
    let notes = folder.path().join("out/p/notes");
    fs::create_dir_all(&notes).unwrap();
    view.retain(&store, ["s".to_owned(), "t".to_owned()].into())
        .unwrap();
    view.retain(&store, ["t".to_owned()].into()).unwrap();
    assert!(notes.exists() && !folder.path().join("out/p/s").exists());
}

#[test]
fn several_at_once_show_one_result_in_one_folder() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(&folder.path().join("store")).unwrap();
    let view = View::new(&folder.path().join("out"), "p");
    let record = commit(&store, key("1"), 1.0, "s");
    let shown = view.output("s", "m");
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for _ in 0..50 {
                    // Whoever finds the folder wrong clears it, while others fill it.
                    let _ = fs::remove_dir_all(&shown);
                    view.show(&store, "s", &record).unwrap();
                }
            });
        }
    });
    view.show(&store, "s", &record).unwrap();
    assert_eq!(Metrics::read(&shown).unwrap(), metrics(1.0));
}

#[test]
fn runs_come_newest_first() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path()).unwrap();
    let run = |pipeline: &str, started: &str| Run {
        pipeline: pipeline.into(),
        started: started.into(),
        seconds: 1.0,
        stages: Default::default(),
        experiment: None,
        command: None,
    };
    for (pipeline, started) in [
        ("a", "20260101T000000.000Z"),
        ("b", "20260102T000000.000Z"),
        ("a", "20260103T000000.000Z"),
    ] {
        store.put_run(&run(pipeline, started)).unwrap();
    }
    let started: Vec<String> = store
        .runs(Some("a"))
        .unwrap()
        .map(|run| run.started)
        .collect();
    assert_eq!(started, ["20260103T000000.000Z", "20260101T000000.000Z"]);
    assert_eq!(store.runs(None).unwrap().count(), 3);
    assert_eq!(now().len(), started[0].len());
}

#[test]
fn a_store_of_another_layout_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("version"), "99\n").unwrap();
    let error = Store::create(folder.path()).err().unwrap().to_string();
    assert!(error.contains("layout 99"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}
