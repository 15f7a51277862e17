//! What was found when files were read through, so that they need not be read again while they have
//! not changed.
//!
//! One file of pages that is only ever added to, a page by each process that found something: a
//! mark, the length and the checksum of what follows, then entries. It is a cache and nothing else:
//! without it, and from a page on that is garbled, everything is read as if for the first time.
//! Knows nothing of what the entries mean.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock};

use artifacts_schema::Digest;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Begins a page. A new number when what any entry consists of changes: nothing in the file says
/// how to read it.
const MARK: &[u8; 8] = b"srnerf3\n";

/// The bytes of a mark, a length and a checksum.
const HEAD: usize = 8 + 8 + 32;

/// As soon as the file is so many times as long as what its entries need, it is written anew.
const SPREAD: usize = 4;

/// A file up to this length is not written anew, however much of it is out of date.
const SHORT: usize = 64 << 10;

/// What an entry is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// A result that was found sound.
    Result = 1,
    /// A folder that shows an artifact.
    Shown = 2,
    /// An answer about files elsewhere.
    Answer = 3,
    /// Manifests that are all there.
    Manifests = 4,
    /// A pipeline all of whose results are there.
    NoOp = 5,
}

/// The name of an entry.
type Name = (u8, Digest);

/// The cache of one store.
#[derive(Default)]
pub struct Index {
    path: PathBuf,
    /// What was in the file when it was first asked for.
    pages: OnceLock<Arc<Pages>>,
    /// What came since.
    new: Mutex<BTreeMap<Name, Vec<u8>>>,
}

#[derive(Default)]
struct Pages {
    bytes: Vec<u8>,
    /// By name, where each one's last entry lies.
    locations: Vec<Location>,
    /// Whether something at the end is no page.
    is_garbled: bool,
}

/// Where an entry lies.
#[derive(Clone)]
pub struct Location {
    name: Name,
    range: Range<usize>,
}

impl Index {
    /// The cache in a file, which need not be there.
    pub fn new(path: PathBuf) -> Self {
        Self {
            path,
            ..Self::default()
        }
    }

    /// The entry of this name.
    pub fn get<T: DeserializeOwned>(&self, kind: Kind, name: &Digest) -> Option<T> {
        let locations = &self.pages().locations;
        // The kind is part of the name, so that no entry is read as one of another type.
        let name = (kind as u8, *name);
        let at = locations
            .binary_search_by(|location| location.name.cmp(&name))
            .ok()?;
        self.read(&locations[at])
    }

    /// Where all entries of a kind lie that were in the file.
    pub fn locations(&self, kind: Kind) -> &[Location] {
        let locations = &self.pages().locations;
        let before = |kind: u8| locations.partition_point(|location| location.name.0 < kind);
        &locations[before(kind as u8)..before(kind as u8 + 1)]
    }

    /// The entry that lies there.
    pub fn read<T: DeserializeOwned>(&self, location: &Location) -> Option<T> {
        // An entry that cannot be read is as good as none: whoever asks reads the files themselves.
        postcard::from_bytes(self.pages().bytes.get(location.range.clone())?).ok()
    }

    /// Adds an entry, or replaces it.
    pub fn put(&self, kind: Kind, name: &Digest, entry: &impl Serialize) {
        if let (Ok(bytes), Ok(mut new)) = (postcard::to_allocvec(entry), self.new.lock()) {
            new.insert((kind as u8, *name), bytes);
        }
    }

    /// Takes over what another index of the same file has read, and what came to it.
    pub fn take(&self, other: &Self) {
        if let Some(pages) = other.pages.get() {
            // This fails where pages were read here already. They are of the same file, and as
            // good.
            let _ = self.pages.set(pages.clone());
        }
        if let (Ok(mut new), Ok(mut others)) = (self.new.lock(), other.new.lock()) {
            new.append(&mut others);
        }
    }

    /// Writes what came since to the end of the file; where that has grown far beyond its entries
    /// or is garbled, it is written anew. It is no matter if that fails.
    pub fn keep(&self, replace: impl FnOnce(&Path, &[u8])) {
        let Ok(mut new) = self.new.lock() else { return };
        let new = std::mem::take(&mut *new);
        let pages = self.pages();
        // A page behind a garbled one would never be read. Pages that others have added since the
        // file was read are lost here, which costs time alone.
        if pages.is_garbled || pages.bytes.len() > SHORT.max(SPREAD * pages.needed()) {
            // What is new takes the place of what was found earlier under the same name.
            let old = pages
                .locations
                .iter()
                .filter(|location| !new.contains_key(&location.name));
            let old = old.map(|location| (location.name, &pages.bytes[location.range.clone()]));
            replace(
                &self.path,
                &page(old.chain(new.iter().map(|(name, bytes)| (*name, &bytes[..])))),
            );
        } else if !new.is_empty() {
            let file = File::options().create(true).append(true).open(&self.path);
            // One call, so that the pages of several processes do not mix.
            let page = page(new.iter().map(|(name, bytes)| (*name, &bytes[..])));
            let _ = file.and_then(|mut file| file.write_all(&page));
        }
    }

    fn pages(&self) -> &Pages {
        self.pages
            .get_or_init(|| Arc::new(Pages::new(fs::read(&self.path).unwrap_or_default())))
    }
}

impl Pages {
    fn new(bytes: Vec<u8>) -> Self {
        // A page is taken as a whole or not at all: its checksum covers every entry in it.
        let mut locations = Vec::new();
        let mut at = 0;
        while let Some(length) = page_length(&bytes[at..]) {
            entries(&bytes, at + HEAD..at + HEAD + length, &mut locations);
            at += HEAD + length;
        }
        let is_garbled = at < bytes.len();
        // The order of pages decides among entries of one name.
        locations.sort_by_key(|location| location.name);
        locations.dedup_by(|later, kept| {
            let same = later.name == kept.name;
            if same {
                kept.range = later.range.clone();
            }
            same
        });
        Self {
            bytes,
            locations,
            is_garbled,
        }
    }

    /// How many bytes the last entries of all names have.
    fn needed(&self) -> usize {
        // Before each entry stand 37 bytes: its kind, the 32 of its name, and 4 of its length.
        self.locations
            .iter()
            .map(|location| location.range.len() + 37)
            .sum()
    }
}

/// A page of entries: of each the kind, the name, the length, and then what it says.
fn page<'e>(entries: impl Iterator<Item = (Name, &'e [u8])>) -> Vec<u8> {
    let mut page = vec![0; HEAD];
    for ((kind, name), bytes) in entries {
        page.push(kind);
        page.extend_from_slice(name.bytes());
        page.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
        page.extend_from_slice(bytes);
    }
    let length = (page.len() - HEAD) as u64;
    let sum = blake3::hash(&page[HEAD..]);
    page[..8].copy_from_slice(MARK);
    page[8..16].copy_from_slice(&length.to_le_bytes());
    page[16..HEAD].copy_from_slice(sum.as_bytes());
    page
}

/// How much follows the head of the page that some bytes begin with; `None` if they do not begin
/// with a sound one.
fn page_length(bytes: &[u8]) -> Option<usize> {
    let (head, rest) = bytes.split_at_checked(HEAD)?;
    let length = usize::try_from(u64::from_le_bytes(head[8..16].try_into().ok()?)).ok()?;
    let sum = blake3::hash(rest.get(..length)?);
    (head[..8] == MARK[..] && head[16..] == sum.as_bytes()[..]).then_some(length)
}

/// Where the entries of a page lie.
fn entries(bytes: &[u8], page: Range<usize>, locations: &mut Vec<Location>) {
    let mut at = page.start;
    while let Some((head, _)) = bytes[at..page.end].split_first_chunk::<37>() {
        let [kind, rest @ ..] = head;
        let (name, length) = rest.split_at(32);
        let (Ok(name), Ok(length)) = (<[u8; 32]>::try_from(name), <[u8; 4]>::try_from(length))
        else {
            return;
        };
        let range = at + 37..at + 37 + u32::from_le_bytes(length) as usize;
        at = range.end;
        // The checksum was right, so this is no damage but another way of writing entries. What
        // came before it can be used.
        if at > page.end {
            return;
        }
        locations.push(Location {
            name: (*kind, Digest::new(name)),
            range,
        });
    }
}

#[cfg(test)]
mod tests;
