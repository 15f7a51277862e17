//! What counts as a result, whatever happens to it.

use std::fs;
use std::path::Path;
use std::time::Duration;

use super::{Breakage, Lookup};
use crate::store::blobs::Damage;
use crate::store::cache::clock::Clock;
use crate::store::cache::index::Kind;
use crate::store::cache::signature::Signature;
use crate::store::record::Record;
use crate::store::testing::{blob, commit, key, lookup, overwrite};
use crate::store::{Store, World};

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
        next.cache.index.locations(Kind::Result).len()
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
