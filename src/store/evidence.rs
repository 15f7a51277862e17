//! The files and folders that one has to look at to see that a result is there as it was. Knows
//! nothing of who looks.

use std::path::{Path, PathBuf};

use super::Store;
use super::cache::signature::Signature;
use super::files::parent;
use super::record::Record;

/// The files and folders that say of a result that it is there and sound.
pub fn sound(store: &Store, record: &Record) -> Vec<PathBuf> {
    // The folder stands for the manifests in it: it changes when one of its names does.
    let files = [
        store.results.path(&record.key),
        parent(&store.manifests.path(&record.key)).to_owned(),
    ];
    files
        .into_iter()
        .chain(record.files().map(|(_, file)| store.blobs.path(&file.blob)))
        .collect()
}

/// Those that say that it is shown, each output in its folder.
pub fn shown(store: &Store, record: &Record, folder: impl Fn(&str) -> PathBuf) -> Vec<PathBuf> {
    // An artifact without files is an empty folder.
    let mut files: Vec<PathBuf> = record.outputs.keys().map(|output| folder(output)).collect();
    for (output, file) in record.files() {
        let folder = folder(output);
        let shown = folder.join(&file.path);
        // Between the file and the artifact's folder may lie others.
        files.extend(
            shown
                .ancestors()
                .skip(1)
                .take_while(|path| path.starts_with(&folder))
                .map(Path::to_owned),
        );
        // A hard link has its blob's signature, and the blob is looked at anyway. A copy has to
        // be looked at by itself.
        if Signature::at(&shown) != Signature::at(&store.blobs.path(&file.blob)) {
            files.push(shown);
        }
    }
    files
}
