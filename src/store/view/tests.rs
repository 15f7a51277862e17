//! What people see, and what of theirs is left alone.

use std::fs;

use artifacts_schema::{Artifact, Metrics};

use super::View;
use crate::store::Store;
use crate::store::testing::{blob, commit, key, metrics, overwrite};

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
