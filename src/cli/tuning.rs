//! The tiles in which a GPU computes matrix products fastest, kept from run to run: they are
//! measured when a GPU of hardware first computes, once per adapter and driver. No result depends
//! on them, so nothing is said where they cannot be kept.

use std::fs;
use std::path::{Path, PathBuf};

use compute::Device;

/// Has a GPU use the tiles that it is fastest with.
pub fn apply(device: &Device) {
    if let Some(folder) = folder() {
        apply_in(&folder, device);
    }
}

/// Where the system wants what can be had again.
fn folder() -> Option<PathBuf> {
    let set = |name| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    let cache = set("XDG_CACHE_HOME")
        .or_else(|| Some(set("HOME")?.join(".cache")))
        .or_else(|| set("LOCALAPPDATA"))?;
    Some(cache.join("srnerf-dag").join("tuning"))
}

fn apply_in(folder: &Path, device: &Device) {
    let path = file(folder, device);
    // Tiles that do not fit this device are measured anew, and the file is replaced.
    let known = fs::read_to_string(&path).is_ok_and(|text| device.tune(&text));
    if !known && device.is_hardware() && device.measure().is_ok() {
        let _ = keep(&path, device);
    }
}

/// The file of an adapter and its driver.
fn file(folder: &Path, device: &Device) -> PathBuf {
    folder.join(format!(
        "{}.txt",
        // The name of an adapter can hold characters that no file name may have.
        &blake3::hash(device.kind().as_bytes()).to_hex()[..16]
    ))
}

/// Writes beside the file and renames, so that nobody reads half of it.
fn keep(path: &Path, device: &Device) -> std::io::Result<()> {
    let Some(tiles) = device.tuning() else {
        return Ok(());
    };
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder)?;
    let draft = tempfile::NamedTempFile::new_in(folder)?;
    fs::write(&draft, format!("{}\n{tiles}", device.kind()))?;
    draft.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use compute::testing;

    #[test]
    fn what_was_kept_is_used_and_what_is_no_tuning_is_not() {
        let Some(device) = testing::gpu() else { return };
        let folder = tempfile::tempdir().unwrap();
        let path = file(folder.path(), &device);
        let usual = device.tuning().unwrap();
        apply_in(folder.path(), &device);
        assert_eq!(
            (device.tuning().unwrap(), path.exists()),
            (usual.clone(), false),
            "software is not measured"
        );
        let other = usual.replace("128x128", "64x128");
        assert!(device.tune(&other));
        keep(&path, &device).unwrap();
        let another = testing::gpu().unwrap();
        apply_in(folder.path(), &another);
        assert_eq!((another.tuning().unwrap(), other != usual), (other, true));
        fs::write(&path, "linear, few tiles: 3x3").unwrap();
        let third = testing::gpu().unwrap();
        apply_in(folder.path(), &third);
        assert_eq!(third.tuning().unwrap(), usual);
    }
}
