//! Posed images that are read and written view by view are those of the whole set.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use artifacts_schema::{Artifact, ImageSet, ImageWriter, StoredImages, View, semantic_digest};
use tempfile::tempdir;

use crate::samples;

/// More views than are read or written together.
fn many() -> ImageSet {
    let images = samples::images();
    let like = &images.views[0];
    let view = |number: usize| View {
        name: format!("view_{number:02}"),
        ..like.clone()
    };
    ImageSet {
        views: (0..19).map(view).chain(images.views.clone()).collect(),
        ..images
    }
}

/// Names and bytes of all files.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = fs::read_dir(folder).unwrap().map(|entry| {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        (name, fs::read(path).unwrap())
    });
    files.collect()
}

#[test]
fn views_that_come_one_by_one_in_any_order_leave_the_files_of_the_whole() {
    let images = many();
    let provenance = samples::provenance();
    let [whole, stream] = [(); 2].map(|()| tempdir().unwrap());
    images.write(whole.path(), &provenance).unwrap();
    let mut writer = ImageWriter::new(stream.path(), images.bounds, images.to_source, &provenance);
    for view in images.views.iter().rev() {
        writer.add(view.clone()).unwrap();
    }
    writer.finish().unwrap();
    assert_eq!(files(stream.path()), files(whole.path()));
}

#[test]
fn views_that_are_read_one_by_one_are_those_of_the_whole() {
    let folder = tempdir().unwrap();
    many().write(folder.path(), &samples::provenance()).unwrap();
    let whole = ImageSet::read(folder.path()).unwrap();
    let stream = StoredImages::open(folder.path()).unwrap();
    let read: Result<Vec<View>, _> = stream.views().collect();
    assert_eq!(read.unwrap(), whole.views);
    let at = stream.find("view_11").unwrap();
    assert_eq!(stream.view(at).unwrap().name, "view_11");
    assert_eq!(stream.find("view_1"), None);
    assert_eq!(stream.semantic_digest().unwrap(), whole.semantic_digest());
    assert_eq!(
        semantic_digest(ImageSet::KIND, folder.path()).unwrap(),
        whole.semantic_digest()
    );
}

#[test]
fn of_some_views_the_others_are_not_read() {
    let folder = tempdir().unwrap();
    many().write(folder.path(), &samples::provenance()).unwrap();
    let whole = ImageSet::read(folder.path()).unwrap();
    fs::remove_file(folder.path().join("view_02.exr")).unwrap();
    let stream = StoredImages::open(folder.path()).unwrap().only(&[3, 5]);
    let read: Result<Vec<View>, _> = stream.views().collect();
    assert_eq!(
        read.unwrap(),
        [whole.views[3].clone(), whole.views[5].clone()]
    );
    assert_eq!(
        (stream.find("view_03"), stream.find("view_02")),
        (Some(1), None)
    );
}

#[test]
fn of_several_broken_views_the_first_is_named() {
    let folder = tempdir().unwrap();
    many().write(folder.path(), &samples::provenance()).unwrap();
    for name in ["view_07.exr", "view_12.exr"] {
        fs::write(folder.path().join(name), "no image").unwrap();
    }
    let stream = StoredImages::open(folder.path()).unwrap();
    let error = stream.views().find_map(Result::err).unwrap().to_string();
    assert!(error.contains("view_07.exr"), "{error}");
    assert!(stream.semantic_digest().is_err());
}

#[test]
fn a_view_that_has_no_form_on_disk_is_refused_when_it_comes() {
    let images = samples::images();
    let provenance = samples::provenance();
    let folder = tempdir().unwrap();
    let mut writer = ImageWriter::new(folder.path(), images.bounds, None, &provenance);
    let view = &images.views[0];
    writer.add(view.clone()).unwrap();
    let twice = writer.add(view.clone()).unwrap_err().to_string();
    assert!(twice.contains("is there twice"), "{twice}");
    let mut short = View {
        name: "short".into(),
        ..view.clone()
    };
    short.pixels.rgb.pop();
    let refused = writer.add(short).unwrap_err().to_string();
    assert!(
        refused.contains("short") && refused.contains("rgb"),
        "{refused}"
    );
    let nameless = View {
        name: "a/b".into(),
        ..view.clone()
    };
    assert!(writer.add(nameless).is_err());
}
