//! The pictures of a comparison, each once: photos, renders and error maps by view. Knows nothing
//! of how they are shown.

use std::collections::BTreeMap;
use std::fmt::Write;

use artifacts_schema::{Artifact, Figures, Picture};

use crate::report::comparison::{Comparison, Scored};
use crate::store::Store;
use crate::store::error::{At, StoreError};
use crate::store::record::Record;

/// Bytes of all pictures together, before they are written as text, which takes a third more: the
/// file stays below 20 MB.
const MOST_BYTES: usize = 14_000_000;

/// A picture.
pub struct Shown {
    number: usize,
    /// Its pixels.
    pub picture: Picture,
    /// Its file, a PNG.
    png: Vec<u8>,
}

impl Shown {
    /// The class of elements that show it.
    pub fn class(&self) -> String {
        format!("p{}", self.number)
    }
}

/// All pictures.
#[derive(Default)]
pub struct Gallery {
    /// The views that have pictures.
    pub views: Vec<String>,
    /// Why some views have none.
    pub note: Option<String>,
    pictures: Vec<Shown>,
    photos: BTreeMap<usize, usize>,
    /// By arm and view.
    renders: BTreeMap<(usize, usize), usize>,
    errors: BTreeMap<(usize, usize), usize>,
}

impl Gallery {
    /// Reads the pictures of all arms, as many views as the file has room for.
    pub fn of(comparison: &Comparison, store: &Store) -> Result<Self, StoreError> {
        let sets = comparison
            .arms
            .iter()
            .map(|arm| Sets::of(arm, store))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self::within(MOST_BYTES, &sets))
    }

    /// As many views as these bytes have room for.
    fn within(most: usize, sets: &[Sets]) -> Self {
        let mut gallery = Self::default();
        let names: std::collections::BTreeSet<&String> =
            sets.iter().flat_map(|sets| sets.renders.keys()).collect();
        let all = names.len();
        let mut bytes = 0;
        for name in names {
            let photo = photo(sets, name).map_or(0, |(_, png)| png.len());
            let of_view = photo + sets.iter().map(|sets| sets.bytes(name)).sum::<usize>();
            // One view is shown even if it is too large by itself: a report without pictures tells
            // too little.
            if bytes + of_view > most && !gallery.views.is_empty() {
                break;
            }
            bytes += of_view;
            gallery.add(name, sets);
        }
        if gallery.views.len() < all {
            let shown = gallery.views.len();
            gallery.note = Some(format!(
                "pictures of {shown} of {all} views: more would make the file too large"
            ));
        }
        gallery
    }

    fn add(&mut self, name: &str, sets: &[Sets]) {
        let view = self.views.len();
        self.views.push(name.to_owned());
        if let Some(photo) = photo(sets, name) {
            let number = self.keep(photo);
            self.photos.insert(view, number);
        }
        for (arm, sets) in sets.iter().enumerate() {
            if let Some(render) = sets.renders.get(name) {
                let number = self.keep(render);
                self.renders.insert((arm, view), number);
            }
            if let Some(error) = sets.errors.get(name) {
                let number = self.keep(error);
                self.errors.insert((arm, view), number);
            }
        }
    }

    fn keep(&mut self, (picture, png): &(Picture, Vec<u8>)) -> usize {
        let number = self.pictures.len();
        self.pictures.push(Shown {
            number,
            picture: picture.clone(),
            png: png.clone(),
        });
        number
    }

    /// The place of a view.
    pub fn place(&self, view: &str) -> Option<usize> {
        self.views.iter().position(|known| known == view)
    }

    /// The photo of a view.
    pub fn photo(&self, view: usize) -> Option<&Shown> {
        Some(&self.pictures[*self.photos.get(&view)?])
    }

    /// What an arm makes of a view.
    pub fn render(&self, arm: usize, view: usize) -> Option<&Shown> {
        Some(&self.pictures[*self.renders.get(&(arm, view))?])
    }

    /// What FLIP sees between that and the photo.
    pub fn error(&self, arm: usize, view: usize) -> Option<&Shown> {
        Some(&self.pictures[*self.errors.get(&(arm, view))?])
    }

    /// How many arms there are pictures of.
    pub fn arms(&self) -> usize {
        self.renders
            .keys()
            // By the highest number and not by how many: an arm in between may have no pictures.
            .map(|(arm, _)| arm + 1)
            .max()
            .unwrap_or(0)
    }

    /// Each picture as a class, so that the file holds it once however often it is shown.
    pub fn styles(&self) -> String {
        let mut styles = String::new();
        for shown in &self.pictures {
            let width = shown.picture.width;
            let height = shown.picture.height;
            let _ = writeln!(
                styles,
                ".{}{{--w:{width};--h:{height};background-image:url(data:image/png;base64,{})}}",
                shown.class(),
                base64(&shown.png),
            );
        }
        styles
    }
}

/// The pictures of one arm, by view.
#[derive(Default)]
struct Sets {
    renders: BTreeMap<String, (Picture, Vec<u8>)>,
    photos: BTreeMap<String, (Picture, Vec<u8>)>,
    errors: BTreeMap<String, (Picture, Vec<u8>)>,
}

impl Sets {
    fn of(arm: &Scored, store: &Store) -> Result<Self, StoreError> {
        let Some(record) = &arm.source else {
            return Ok(Self::default());
        };
        Ok(Self {
            renders: pictures(store, record, "renders")?,
            photos: pictures(store, record, "photos")?,
            errors: pictures(store, record, "flip")?,
        })
    }

    /// Of all but the photo.
    fn bytes(&self, view: &str) -> usize {
        let sets = [&self.renders, &self.errors];
        let of_view = sets.iter().filter_map(|set| set.get(view));
        of_view.map(|(_, png)| png.len()).sum()
    }
}

/// The photo of a view, which all arms have and the file holds once.
fn photo<'s>(sets: &'s [Sets], view: &str) -> Option<&'s (Picture, Vec<u8>)> {
    sets.iter().find_map(|sets| sets.photos.get(view))
}

/// The pictures of an output with their files.
fn pictures(
    store: &Store,
    record: &Record,
    name: &str,
) -> Result<BTreeMap<String, (Picture, Vec<u8>)>, StoreError> {
    let Some(output) = record.outputs.get(name) else {
        return Ok(BTreeMap::new());
    };
    let folder = tempfile::tempdir().at("create a folder in", &std::env::temp_dir())?;
    output.show(store, folder.path())?;
    let figures = Figures::read(folder.path()).map_err(|error| StoreError::Output {
        output: name.to_owned(),
        problem: error.to_string(),
    })?;
    let mut pictures = BTreeMap::new();
    for (view, picture) in figures.images {
        // The file goes into the page as it is. Its pixels are for finding crops.
        let path = folder.path().join(format!("{view}.png"));
        let png = std::fs::read(&path).at("read", &path)?;
        pictures.insert(view, (picture, png));
    }
    Ok(pictures)
}

/// Bytes as text (RFC 4648).
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let part = |at: usize| u32::from(chunk.get(at).copied().unwrap_or(0));
        let bits = part(0) << 16 | part(1) << 8 | part(2);
        for digit in 0..4 {
            // A chunk of n bytes fills n + 1 of its four digits. The rest is padding.
            if digit <= chunk.len() {
                let value = bits >> (18 - 6 * digit) & 63;
                text.push(char::from(DIGITS[value as usize]));
            } else {
                text.push('=');
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_bytes_are_shown_than_there_is_room_for() {
        let picture = |view: &str| {
            let picture = Picture {
                width: 1,
                height: 1,
                rgb8: vec![0; 3],
                legend: BTreeMap::new(),
            };
            (view.to_owned(), (picture, vec![0; 10]))
        };
        let all = || ["a", "b", "c"].map(picture).into();
        let arm = || Sets {
            renders: all(),
            photos: all(),
            errors: all(),
        };
        // Two arms: a photo, two renders and two errors for each view.
        let gallery = Gallery::within(100, &[arm(), arm()]);
        let shown: usize = gallery.pictures.iter().map(|shown| shown.png.len()).sum();
        assert_eq!((gallery.views.len(), shown), (2, 100));
        let gallery = Gallery::within(99, &[arm(), arm()]);
        assert_eq!(gallery.views, ["a"]);
        assert!(
            gallery
                .note
                .unwrap()
                .starts_with("pictures of 1 of 3 views")
        );
    }

    #[test]
    fn bytes_become_the_text_that_the_standard_gives() {
        let known = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
        ];
        for (bytes, text) in known {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[255, 254]), "//4=");
    }
}
