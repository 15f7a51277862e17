//! nerfstudio's lists of which photos are for training, validation and testing. Knows no files.

use std::collections::BTreeSet;

use super::page::Page;
use crate::parsed::Posed;
use crate::photo_file;

/// Photos by what they are for.
pub(super) struct Split {
    pub(super) train: Vec<Posed>,
    pub(super) test: Vec<Posed>,
}

/// Splits photos, given with their `file_path`, by the lists of their file; without lists all are
/// for training. Where there is no list for testing, the one for validation serves.
pub(super) fn split(page: &Page, photos: Vec<(String, Posed)>, notes: &mut Vec<String>) -> Split {
    let set = |list: &[String]| list.iter().map(|path| same(path)).collect::<BTreeSet<_>>();
    let train_list = set(&page.train_filenames);
    let validation = set(&page.val_filenames);
    let test_list = set(&page.test_filenames);
    // While it trains, nerfstudio itself measures on the list for validation.
    let held_out = match test_list.is_empty() {
        true => &validation,
        false => &test_list,
    };
    note_unknown(page, notes);
    let mut split = Split {
        train: Vec::new(),
        test: Vec::new(),
    };
    let mut unused = 0;
    let mut both = 0;
    for (path, posed) in photos {
        // Compared as paths, since exporters write the lists apart from the frames.
        let path = same(&path);
        let for_training = match train_list.is_empty() {
            // Without a list for training, all but what validates is trained on.
            true => !validation.contains(&path),
            false => train_list.contains(&path),
        };
        // Held out wins: what a stage has seen must not be measured on.
        if held_out.contains(&path) {
            both += usize::from(train_list.contains(&path));
            split.test.push(posed);
        } else if for_training {
            split.train.push(posed);
        } else {
            unused += 1;
        }
    }
    if unused > 0 {
        notes.push(format!(
            "{unused} photos are used neither for training nor for testing: they are in val_filenames beside a list for \
             testing, or in no list"
        ));
    }
    if both > 0 {
        notes.push(format!(
            "{both} photos are listed for training and for testing: they are held out"
        ));
    }
    split
}

/// Says which entries of the lists name no frame.
fn note_unknown(page: &Page, notes: &mut Vec<String>) {
    let frames: BTreeSet<String> = page
        .frames
        .iter()
        .map(|frame| same(&frame.file_path))
        .collect();
    for (name, list) in [
        ("train_filenames", &page.train_filenames),
        ("val_filenames", &page.val_filenames),
        ("test_filenames", &page.test_filenames),
    ] {
        let unknown: Vec<&String> = list
            .iter()
            .filter(|path| !frames.contains(&same(path)))
            .collect();
        if let Some(first) = unknown.first() {
            notes.push(format!(
                "{} of {} entries of {name} name no frame, such as {first}",
                unknown.len(),
                list.len()
            ));
        }
    }
}

/// A path by which two texts that mean one photo are the same: `./images/1.png`, `images\1.png` and
/// `images/1`.
fn same(path: &str) -> String {
    let slashed = path.replace('\\', "/");
    let parts: Vec<&str> = slashed
        .split('/')
        .filter(|part| !part.is_empty() && *part != ".")
        .collect();
    photo_file::split(&parts.join("/")).0.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_name_photos_by_paths_not_by_texts() {
        for path in [
            "images/a.png",
            "./images/a.png",
            "images\\a.png",
            "images//a",
        ] {
            assert_eq!(same(path), "images/a");
        }
    }
}
