//! What an index keeps, and what it survives.

use super::*;

fn name(text: &str) -> Digest {
    blake3::hash(text.as_bytes()).into()
}

fn keep(index: &Index) {
    index.keep(|path, bytes| fs::write(path, bytes).unwrap());
}

#[test]
fn entries_are_found_again_the_last_of_each_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("index");
    for value in 0..3 {
        let index = Index::new(path.clone());
        index.put(Kind::Shown, &name("a"), &value);
        index.put(Kind::Result, &name(&value.to_string()), &(value, "text"));
        keep(&index);
    }
    let index = Index::new(path.clone());
    assert_eq!(index.get(Kind::Shown, &name("a")), Some(2));
    assert_eq!(
        index.get(Kind::Result, &name("1")),
        Some((1, "text".to_owned()))
    );
    assert_eq!(index.get::<u32>(Kind::Shown, &name("b")), None);
    assert_eq!(
        index.get::<i32>(Kind::Result, &name("a")),
        None,
        "another kind"
    );
    let results = index
        .locations(Kind::Result)
        .iter()
        .map(|location| index.read::<(i32, String)>(location).unwrap().0);
    assert_eq!(
        results.collect::<std::collections::BTreeSet<_>>(),
        (0..3).collect()
    );
}

#[test]
fn a_garbled_page_has_no_entries_and_the_file_is_written_anew() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("index");
    for value in 0..3 {
        let index = Index::new(path.clone());
        index.put(Kind::Answer, &name(&value.to_string()), &value);
        keep(&index);
    }
    let found = |index: &Index| {
        (0..4)
            .filter(|value| index.get(Kind::Answer, &name(&value.to_string())) == Some(*value))
            .count()
    };
    let whole = fs::read(&path).unwrap();
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        fs::write(&path, &bytes).unwrap();
        let index = Index::new(path.clone());
        assert_eq!(
            found(&index),
            at / (whole.len() / 3),
            "the pages before, {at}"
        );
        index.put(Kind::Answer, &name("3"), &3);
        keep(&index);
        assert_eq!(found(&Index::new(path.clone())), at / (whole.len() / 3) + 1);
    }
}

#[test]
fn a_file_that_has_grown_is_written_anew() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("index");
    for value in 0..60 {
        let index = Index::new(path.clone());
        (0..50).for_each(|at| index.put(Kind::Shown, &name(&at.to_string()), &value));
        keep(&index);
    }
    let length = fs::metadata(&path).unwrap().len() as usize;
    assert!(
        length < SHORT + 4000,
        "60 pages of some 2000 bytes: {length}"
    );
    assert_eq!(Index::new(path).get(Kind::Shown, &name("7")), Some(59));
}
