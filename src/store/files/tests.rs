//! What lies in a folder already.

use std::fs;

use crate::store::Store;

#[test]
fn a_store_of_another_layout_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("version"), "99\n").unwrap();
    let error = Store::create(folder.path()).err().unwrap().to_string();
    assert!(error.contains("layout 99"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}
