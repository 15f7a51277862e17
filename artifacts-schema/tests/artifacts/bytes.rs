//! Equal content and equal provenance give equal files, in any process and on any number of
//! threads.

use std::process::Command;

use tempfile::tempdir;

use crate::samples;

/// Set for the child process of the test below: the folder that it writes into.
const FOLDER: &str = "SRNERF_TEST_FOLDER";

#[test]
fn equal_artifacts_are_equal_files() {
    let first = tempdir().unwrap();
    samples::write_all(first.path(), &samples::provenance()).unwrap();
    let expected = samples::files(first.path());
    for threads in 1..=16 {
        let again = tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads % 4 + 1)
            .build()
            .unwrap();
        pool.install(|| samples::write_all(again.path(), &samples::provenance()))
            .unwrap();
        assert_eq!(samples::files(again.path()), expected);
    }
}

/// The second process is this test again, with a folder in its environment.
#[test]
fn equal_artifacts_of_two_processes_are_equal_files() {
    if let Some(folder) = std::env::var_os(FOLDER) {
        return samples::write_all(folder.as_ref(), &samples::provenance()).unwrap();
    }
    let here = tempdir().unwrap();
    let there = tempdir().unwrap();
    samples::write_all(here.path(), &samples::provenance()).unwrap();
    let child = Command::new(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "bytes::equal_artifacts_of_two_processes_are_equal_files",
        ])
        .env(FOLDER, there.path())
        .output()
        .unwrap();
    assert!(child.status.success(), "{child:?}");
    assert!(!samples::files(there.path()).is_empty());
    assert_eq!(samples::files(there.path()), samples::files(here.path()));
}

#[test]
fn provenance_changes_the_files() {
    let one = tempdir().unwrap();
    let other = tempdir().unwrap();
    let mut provenance = samples::provenance();
    samples::write_all(one.path(), &provenance).unwrap();
    provenance.key = "00".repeat(32);
    samples::write_all(other.path(), &provenance).unwrap();
    let one = samples::files(one.path());
    let other = samples::files(other.path());
    for file in [
        "images/view_000.exr",
        "images/transforms.json",
        "latents/latents.safetensors",
        "log/provenance.json",
    ] {
        assert_ne!(one[file], other[file], "{file}");
    }
}
