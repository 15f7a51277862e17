//! What was found when files were read through, so that they need not be read again while they have not changed.
//!
//! One file of lines that is only ever added to: a checksum, a name and JSON each. It is a cache and nothing else: without it, or where
//! a line is garbled, everything is read as if for the first time. Knows nothing of what the entries mean.

use std::collections::BTreeMap;
use std::fs::{self, File, Metadata};
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use artifacts_schema::Digest;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// A file that changed less than this before it was read may change again without a sign of it: clocks of file systems are coarse.
const RACY: Duration = Duration::from_secs(2);

/// More lines than this for each entry, and the file is written anew.
const LINES_PER_ENTRY: usize = 4;

/// What tells that a file is as it was: inode, size, and when its content and its inode changed, in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Signature(u64, u64, i128, i128);

impl Signature {
    /// Of a file that is there; `None` where the system does not say enough.
    #[cfg(unix)]
    pub fn of(data: &Metadata) -> Option<Self> {
        use std::os::unix::fs::MetadataExt;
        let nanos = |seconds: i64, nanos: i64| i128::from(seconds) * 1_000_000_000 + i128::from(nanos);
        let (modified, changed) = (nanos(data.mtime(), data.mtime_nsec()), nanos(data.ctime(), data.ctime_nsec()));
        Some(Self(data.ino(), data.len(), modified, changed))
    }

    /// Of a file that is there; `None` where the system does not say enough.
    #[cfg(not(unix))]
    pub fn of(_: &Metadata) -> Option<Self> {
        None
    }

    /// Of the file at a path.
    pub fn at(path: &Path) -> Option<Self> {
        Self::of(&fs::metadata(path).ok()?)
    }

    /// Whether the file was left alone for long enough before `now` that any change after it would show.
    pub fn is_settled(&self, now: SystemTime) -> bool {
        let now = now.duration_since(UNIX_EPOCH).unwrap_or_default().saturating_sub(RACY).as_nanos() as i128;
        self.2 < now && self.3 < now
    }
}

/// The cache of one store.
#[derive(Default)]
pub struct Index {
    path: PathBuf,
    /// What was in the file when it was first asked for.
    lines: OnceLock<Lines>,
    /// What came since: by name, as lines.
    new: Mutex<BTreeMap<Digest, String>>,
}

#[derive(Default)]
struct Lines {
    text: String,
    /// Where each entry's last line lies.
    places: BTreeMap<Digest, Range<usize>>,
    /// How many lines there are.
    count: usize,
}

impl Index {
    /// The cache in a file, which need not be there.
    pub fn new(path: PathBuf) -> Self {
        Self { path, ..Self::default() }
    }

    /// The entry of this name.
    pub fn get<T: DeserializeOwned>(&self, name: &Digest) -> Option<T> {
        let lines = self.lines();
        let line = &lines.text[lines.places.get(name)?.clone()];
        let (sum, rest) = line.split_at_checked(17)?;
        let sound = sum[..16] == checksum(rest)[..];
        serde_json::from_str(rest.get(65..).filter(|_| sound)?).ok()
    }

    /// The names of all entries that were in the file.
    pub fn names(&self) -> Vec<Digest> {
        self.lines().places.keys().copied().collect()
    }

    /// Adds an entry, or replaces it.
    pub fn put(&self, name: &Digest, entry: &impl Serialize) {
        if let (Ok(json), Ok(mut new)) = (serde_json::to_string(entry), self.new.lock()) {
            let rest = format!("{name} {json}");
            new.insert(*name, format!("{} {rest}\n", checksum(&rest)));
        }
    }

    /// Takes over what came to another index of the same file.
    pub fn take(&self, other: &Self) {
        if let (Ok(mut new), Ok(mut others)) = (self.new.lock(), other.new.lock()) {
            new.append(&mut others);
        }
    }

    /// Writes what came since to the end of the file; where it has grown far beyond its entries, it is written anew. It is no matter if
    /// that fails.
    pub fn keep(&self, replace: impl FnOnce(&Path, &[u8])) {
        let Ok(mut new) = self.new.lock() else { return };
        let new = std::mem::take(&mut *new);
        let lines = self.lines();
        if lines.count + new.len() > LINES_PER_ENTRY * (lines.places.len() + 256) {
            let old = lines.places.iter().filter(|(name, _)| !new.contains_key(*name));
            let old: String = old.map(|(_, place)| format!("{}\n", &lines.text[place.clone()])).collect();
            replace(&self.path, (old + &new.into_values().collect::<String>()).as_bytes());
        } else if !new.is_empty() {
            let file = File::options().create(true).append(true).open(&self.path);
            // One call, so that the lines of several processes do not mix.
            let _ = file.and_then(|mut file| file.write_all(new.into_values().collect::<String>().as_bytes()));
        }
    }

    fn lines(&self) -> &Lines {
        self.lines.get_or_init(|| Lines::new(fs::read(&self.path).unwrap_or_default()))
    }
}

impl Lines {
    fn new(bytes: Vec<u8>) -> Self {
        let Ok(text) = String::from_utf8(bytes) else { return Self::default() };
        let (mut places, mut count, mut at) = (Vec::new(), 0, 0);
        for line in text.split_inclusive('\n') {
            let place = at..at + line.len() - 1;
            at += line.len();
            count += 1;
            if let Some(name) = line.get(17..81).and_then(|name| name.parse().ok())
                && line.ends_with('\n')
            {
                places.push((name, place));
            }
        }
        Self { places: places.into_iter().collect(), count, text }
    }
}

fn checksum(text: &str) -> String {
    blake3::hash(text.as_bytes()).to_hex()[..16].to_owned()
}

#[cfg(test)]
mod tests {
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
            index.put(&name("a"), &value);
            index.put(&name(&value.to_string()), &(value, "text"));
            keep(&index);
        }
        let index = Index::new(path.clone());
        assert_eq!(index.get(&name("a")), Some(2));
        assert_eq!(index.get(&name("1")), Some((1, "text".to_owned())));
        assert_eq!(index.get::<u32>(&name("b")), None);
        assert_eq!(index.get::<String>(&name("a")), None);
    }

    #[test]
    fn a_garbled_line_is_no_entry_and_spoils_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("index");
        let index = Index::new(path.clone());
        (0..10).for_each(|value| index.put(&name(&value.to_string()), &value));
        keep(&index);
        let whole = fs::read(&path).unwrap();
        for at in (0..whole.len()).step_by(7) {
            let mut bytes = whole.clone();
            bytes[at] ^= 1;
            fs::write(&path, &bytes[..whole.len() - 3]).unwrap();
            let index = Index::new(path.clone());
            let found: Vec<i32> = (0..10).filter_map(|value| index.get::<i32>(&name(&value.to_string()))).collect();
            assert!(found.iter().all(|value| (0..10).contains(value)) && found.len() >= 7, "{at}: {found:?}");
            assert!(
                (0..10).all(|value| index.get::<i32>(&name(&value.to_string())).is_none_or(|found| found == value))
            );
        }
    }

    #[test]
    fn a_file_that_has_grown_is_written_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("index");
        for value in 0..40 {
            let index = Index::new(path.clone());
            (0..50).for_each(|at| index.put(&name(&at.to_string()), &value));
            keep(&index);
        }
        let lines = fs::read_to_string(&path).unwrap().lines().count();
        assert!(lines <= LINES_PER_ENTRY * 306, "{lines}");
        assert_eq!(Index::new(path).get(&name("7")), Some(39));
    }

    #[test]
    fn a_file_that_changed_just_now_is_not_settled() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, "1").unwrap();
        let Some(signature) = Signature::at(&path) else { return };
        assert!(!signature.is_settled(SystemTime::now()));
        assert!(signature.is_settled(SystemTime::now() + Duration::from_secs(3)));
        assert!(!signature.is_settled(SystemTime::now() - Duration::from_secs(3600)), "a clock that was set back");
    }
}
