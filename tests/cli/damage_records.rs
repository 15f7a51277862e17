//! Every kind of damage that the records of results and runs, and manifests, can take.

use std::fs;

use serde_json::{Value, json};

use crate::victim::{Victim, overwrite};

#[test]
fn a_garbled_result() {
    let victim = Victim::new();
    overwrite(&victim.result(), |bytes| bytes.truncate(40));
    victim.suffers(&["results/", "garbled: "], &["up"]);
}

#[test]
fn a_result_of_another_version() {
    let victim = Victim::new();
    overwrite(&victim.result(), |bytes| {
        *bytes = json!({"format": 9, "data": []}).to_string().into()
    });
    victim.suffers(&["results/", "garbled: missing field `key`"], &["up"]);
}

#[test]
fn a_result_of_another_key() {
    let victim = Victim::new();
    let other = victim
        .result()
        .with_file_name(format!("{}.json", "0".repeat(64)));
    fs::rename(victim.result(), other).unwrap();
    victim.suffers(&["it is about the key "], &["up"]);
}

#[test]
fn a_result_that_leads_out_of_its_folder() {
    let victim = Victim::new();
    let mut result = victim.up.clone();
    result["outputs"]["images"]["files"][0]["path"] = "../../elsewhere".into();
    overwrite(&victim.result(), |bytes| *bytes = result.to_string().into());
    victim.suffers(&["leads out of its folder"], &["up"]);
}

#[test]
fn a_folder_where_a_result_should_be() {
    let victim = Victim::new();
    fs::remove_file(victim.result()).unwrap();
    fs::create_dir(victim.result()).unwrap();
    victim.suffers(&["results/", "there is a folder"], &["up"]);
}

#[test]
fn a_garbled_manifest() {
    let victim = Victim::new();
    overwrite(&victim.manifest(), |bytes| bytes[0] = b'?');
    let said = victim.fsck(&[]);
    assert!(
        said.code == 5 && said.out.contains("manifests/") && said.out.contains("garbled: "),
        "{}",
        said.out
    );
    victim.heals(&[]);
}

#[test]
fn a_manifest_that_disagrees_with_its_key() {
    let victim = Victim::new();
    let mut manifest: Value =
        serde_json::from_slice(&fs::read(victim.manifest()).unwrap()).unwrap();
    manifest["params.factor"] = "3.0".into();
    overwrite(&victim.manifest(), |bytes| {
        *bytes = manifest.to_string().into()
    });
    let said = victim.fsck(&[]);
    assert!(
        said.code == 5 && said.out.contains("it is about the key "),
        "{}",
        said.out
    );
    victim.heals(&[]);
}

#[test]
fn a_missing_manifest_is_written_again_by_a_run() {
    let victim = Victim::new();
    fs::remove_file(victim.manifest()).unwrap();
    let said = victim.fsck(&[]);
    assert!(
        said.code == 5 && said.out.contains("its manifest is gone"),
        "{}",
        said.out
    );
    victim.heals(&[]);
}

#[test]
fn a_garbled_record_of_a_run() {
    let victim = Victim::new();
    fs::write(
        victim
            .space
            .path(".srnerf/runs/20260101T000000.000Z-tiny.json"),
        "{",
    )
    .unwrap();
    victim.suffers(&["runs/", "garbled: "], &[]);
}
