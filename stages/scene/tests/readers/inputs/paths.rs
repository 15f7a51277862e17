//! How files of poses name photos, and what of them is left out, set aside or refused.

use super::{capture, for_frames, holds, read, refusal, rewrite, transforms};
use scene::{Reader, Transforms};
use serde_json::json;

#[test]
fn paths_are_read_however_they_were_written() {
    for path in [
        "images\\{}.png",
        "./images/{}.png",
        "images/{}",
        "Images/{}.PNG",
        "images/{}.jpg",
        "C:\\Users\\someone\\scene\\images\\{}.png",
        "/elsewhere/scene/images/{}.png",
    ] {
        let folder = capture(|page| {
            for_frames(page, |i, frame| {
                frame["file_path"] = json!(path.replace("{}", &format!("{i:04}")));
            });
        });
        assert_eq!(read(&folder), (9, String::new()), "{path}");
    }
}

#[test]
fn names_in_another_case_or_with_another_ending_are_found() {
    let folder = capture(|_| {});
    for (i, ending) in ["JPEG", "PNG", "Jpg"].iter().cycle().take(9).enumerate() {
        let old = folder.path().join(format!("images/{i:04}.png"));
        std::fs::rename(old, folder.path().join(format!("images/{i:04}.{ending}"))).unwrap();
    }
    assert_eq!(read(&folder), (9, String::new()));
}

#[test]
fn validation_photos_are_held_out_where_there_is_no_list_for_testing() {
    let list = |range: std::ops::Range<usize>| {
        json!(
            range
                .map(|i| format!("./images/{i:04}.png"))
                .collect::<Vec<_>>()
        )
    };
    let folder = capture(|page| {
        page["train_filenames"] = list(0..6);
        page["val_filenames"] = list(6..9);
    });
    let scene = transforms(&folder).unwrap();
    assert_eq!((scene.photos.len(), scene.test.len()), (6, 3));
    assert_eq!(scene.notes, Vec::<String>::new());
    let folder = capture(|page| {
        page["train_filenames"] = list(0..5);
        page["test_filenames"] = list(6..10);
    });
    let (count, notes) = read(&folder);
    assert_eq!(count, 8);
    holds(
        &notes,
        &[
            "1 photos are used neither for training nor for testing",
            "1 of 4 entries of test_filenames name no frame",
        ],
    );
}

#[test]
fn rounding_in_the_last_row_is_forgiven() {
    let folder = capture(|page| {
        for_frames(page, |_, frame| {
            frame["transform_matrix"][3][2] = json!(2.2e-16)
        });
    });
    assert_eq!(read(&folder).0, 9);
}

#[test]
fn a_byte_order_mark_is_read_over() {
    let folder = capture(|_| {});
    rewrite(&folder, |text| format!("\u{feff}{text}").into_bytes());
    assert_eq!(read(&folder), (9, String::new()));
    let folder = capture(|_| {});
    rewrite(&folder, |text| {
        let units = text.encode_utf16().flat_map(u16::to_be_bytes);
        [0xFE, 0xFF].into_iter().chain(units).collect()
    });
    assert_eq!(transforms(&folder).unwrap().photos.len(), 9, "UTF-16");
}

#[test]
fn one_bad_frame_of_nine_is_left_out_by_name_and_two_are_refused() {
    let spoilt = |count: usize, value: &str| {
        let folder = capture(|page| {
            for_frames(page, |i, frame| {
                if (3..3 + count).contains(&i) {
                    frame["transform_matrix"][0][3] = json!("VALUE");
                }
            });
        });
        rewrite(&folder, |text| {
            text.replace("\"VALUE\"", value).into_bytes()
        });
        folder
    };
    for value in ["NaN", "Infinity", "-Infinity", "null", "1e999"] {
        let folder = spoilt(1, value);
        match value {
            // No number at all: the place is named instead.
            "1e999" => holds(&refusal(&folder), &["transforms.json: line 1, column"]),
            _ => {
                let (count, notes) = read(&folder);
                assert_eq!(count, 8, "{value}");
                holds(
                    &notes,
                    &["frame \"images/0003.png\" is left out", "not finite"],
                );
            }
        }
    }
    holds(
        &refusal(&spoilt(2, "NaN")),
        &[
            "frame \"images/0003.png\": transform_matrix holds",
            "(and 1 more of 9 photos)",
        ],
    );
}

#[test]
fn a_file_that_was_cut_short_says_so() {
    let folder = capture(|_| {});
    rewrite(&folder, |text| text.as_bytes()[..text.len() / 2].to_vec());
    holds(
        &refusal(&folder),
        &["SCENE/transforms.json: line 1, column", "was cut short"],
    );
}

#[test]
fn what_is_there_is_not_called_missing() {
    let folder = capture(|_| {});
    for i in 0..9 {
        let old = folder.path().join(format!("images/{i:04}.png"));
        std::fs::rename(old, folder.path().join(format!("images/{i:04}.HEIC"))).unwrap();
    }
    holds(
        &refusal(&folder),
        &[
            "SCENE/images/0000.HEIC",
            "HEIC, which is not read",
            "convert it to",
        ],
    );
    let folder = capture(|_| {});
    let pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n";
    std::fs::write(folder.path().join("images/0002.png"), pointer).unwrap();
    holds(
        &refusal(&folder),
        &[
            "SCENE/images/0002.png: is a git-lfs pointer",
            "git lfs pull",
        ],
    );
    rewrite(&folder, |_| pointer.into());
    holds(
        &refusal(&folder),
        &["SCENE/transforms.json: is a git-lfs pointer"],
    );
}

#[test]
fn a_photo_with_two_poses_is_refused_and_photos_without_one_are_counted() {
    let folder = capture(|page| page["frames"][5]["file_path"] = json!("./images/0004.png"));
    holds(&refusal(&folder), &["images/0004.png: has two poses"]);
    let folder = capture(|page| {
        page["frames"].as_array_mut().unwrap().truncate(3);
    });
    holds(&read(&folder).1, &["3 of 9 photos have a pose", "left out"]);
}

#[test]
fn photos_that_are_enlarged_are_noted() {
    let folder = capture(|_| {});
    let scene = Transforms {
        path: folder.path().to_owned(),
        size: Some((32, 24)),
        ..Transforms::default()
    };
    holds(
        &scene.read().unwrap().notes.join("\n"),
        &["9 photos are smaller than the 32x24"],
    );
}

#[test]
fn another_programs_camera_path_is_refused_by_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera_path.json");
    let page = json!({"camera_type": "perspective", "camera_path": [{"camera_to_world": [1, 0], "fov": 50}]});
    std::fs::write(&path, page.to_string()).unwrap();
    let said = scene::path_digest(&path).unwrap_err().to_string();
    holds(
        &said,
        &[
            "camera_path.json",
            "a camera path of nerfstudio's viewer",
            "expected a list of frames",
        ],
    );
}
