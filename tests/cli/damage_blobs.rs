//! Every kind of damage that blobs can take.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};

use crate::victim::{Victim, overwrite};

#[test]
fn a_flipped_bit() {
    let victim = Victim::new();
    overwrite(&victim.blob(), |bytes| bytes[100] ^= 4);
    victim.suffers(
        &["its bytes have changed", "up: images/", "its blob is lost"],
        &["up"],
    );
}

#[test]
fn a_truncated_blob() {
    let victim = Victim::new();
    overwrite(&victim.blob(), |bytes| bytes.truncate(7));
    victim.suffers(&["cut short: 7 of ", "up: images/"], &["up"]);
}

#[test]
fn a_grown_blob() {
    let victim = Victim::new();
    overwrite(&victim.blob(), |bytes| bytes.extend(b"more"));
    victim.suffers(&["grown: ", "up: images/"], &["up"]);
}

#[test]
fn a_missing_blob() {
    let victim = Victim::new();
    fs::remove_file(victim.blob()).unwrap();
    victim.suffers(&["results/", "its blob is lost: up: images/"], &["up"]);
}

#[test]
fn a_blob_under_another_name_goes_back_to_its_place() {
    let victim = Victim::new();
    let lost = victim.blob().with_file_name("0".repeat(64));
    fs::rename(victim.blob(), lost).unwrap();
    victim.suffers(&["it is the blob "], &[]);
}

#[test]
fn a_blob_that_can_be_written_is_protected_again() {
    let victim = Victim::new();
    fs::set_permissions(victim.blob(), Permissions::from_mode(0o644)).unwrap();
    victim.suffers(&["it can be written"], &[]);
}

#[test]
fn a_folder_where_a_blob_should_be() {
    let victim = Victim::new();
    fs::remove_file(victim.blob()).unwrap();
    fs::create_dir_all(victim.blob().join("inner")).unwrap();
    victim.suffers(&["there is a folder", "its blob is lost"], &["up"]);
}

#[test]
fn a_link_that_leads_to_itself_where_a_blob_should_be() {
    let victim = Victim::new();
    fs::remove_file(victim.blob()).unwrap();
    symlink(victim.blob(), victim.blob()).unwrap();
    victim.suffers(&["there is a link", "its blob is lost"], &["up"]);
}

#[test]
fn a_file_where_a_folder_of_blobs_should_be() {
    let victim = Victim::new();
    let folders = (0..=255).map(|byte| victim.space.path(&format!(".srnerf/cas/{byte:02x}")));
    let free = folders.into_iter().find(|folder| !folder.exists()).unwrap();
    fs::write(free, "").unwrap();
    victim.suffers(&["cas/", "there is a file"], &[]);
}
