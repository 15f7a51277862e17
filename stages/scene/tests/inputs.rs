//! Inputs of the kinds that people bring, each with what they expect: how many photos are read,
//! what a warning says, what a refusal says.
#![allow(clippy::unwrap_used)] // The helpers of tests are tests too.

mod common;

use std::fmt::Write;
use std::path::Path;

use common::{colmap, words};
use glam::{DQuat, DVec3};
use image::{DynamicImage, ImageFormat, Luma, Rgb, Rgb32FImage, RgbImage};
use scene::{Camera, Reader, SceneData, Transforms};
use serde_json::{Value, json};
use tempfile::TempDir;

const SIZE: (u32, u32) = (16, 12);

/// Cameras on a ring of radius 3 that look at the origin.
fn ring(count: usize) -> Vec<Camera> {
    let camera = |i: usize| {
        let angle = std::f64::consts::TAU * i as f64 / count as f64;
        let position = DVec3::new(3.0 * angle.sin(), 0.6, 3.0 * angle.cos());
        Camera::centered(
            SIZE,
            15.0,
            Camera::look_at(position, DVec3::ZERO),
            [1.0, 5.0],
        )
    };
    (0..count).map(camera).collect()
}

fn photo(i: usize) -> RgbImage {
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        Rgb([x as u8 * 15, y as u8 * 20, i as u8])
    })
}

fn save(image: impl Into<DynamicImage>, path: &Path, format: ImageFormat) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.into().save_with_format(path, format).unwrap();
}

/// Nine photos and their `transforms.json`, changed.
fn capture(change: impl Fn(&mut Value)) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let frame = |(i, camera): (usize, &Camera)| {
        let name = format!("images/{i:04}.png");
        save(photo(i), &folder.path().join(&name), ImageFormat::Png);
        let rows = camera.camera_to_world.transpose().to_cols_array_2d();
        json!({"file_path": name, "transform_matrix": rows})
    };
    let frames: Vec<Value> = ring(9).iter().enumerate().map(frame).collect();
    let (w, h) = SIZE;
    let mut page = json!({"fl_x": 15.0, "w": w, "h": h, "aabb_scale": 4, "frames": frames});
    change(&mut page);
    std::fs::write(folder.path().join("transforms.json"), page.to_string()).unwrap();
    folder
}

/// The text of the file, changed.
fn rewrite(folder: &TempDir, change: impl Fn(String) -> Vec<u8>) {
    let path = folder.path().join("transforms.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(path, change(text)).unwrap();
}

fn transforms(folder: &TempDir) -> Result<SceneData, scene::SceneError> {
    let path = folder.path().to_owned();
    Transforms {
        path,
        ..Transforms::default()
    }
    .read()
}

/// The photos read, and the notes as one text.
fn read(folder: &TempDir) -> (usize, String) {
    let scene = transforms(folder).unwrap();
    (
        scene.photos.len() + scene.test.len(),
        scene.notes.join("\n"),
    )
}

fn refusal(folder: &TempDir) -> String {
    words(transforms(folder).unwrap_err(), folder.path())
}

#[track_caller]
fn holds(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part} is not in: {text}");
    }
}

fn for_frames(page: &mut Value, change: impl Fn(usize, &mut Value)) {
    let frames = page["frames"].as_array_mut().unwrap();
    frames
        .iter_mut()
        .enumerate()
        .for_each(|(i, frame)| change(i, frame));
}

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
fn a_lens_that_folds_the_image_is_told_in_numbers_with_a_remedy() {
    let folder = capture(|page| {
        page["k1"] = json!(-44.0);
        page["p1"] = json!(0.6);
    });
    let said = refusal(&folder);
    holds(
        &said,
        &[
            "frame \"images/0000.png\"",
            "k1 = -44, p1 = 0.6",
            "undistort",
        ],
    );
    assert!(!said.contains('{'), "no debug print: {said}");
}

#[test]
fn camera_models_are_read_in_any_case_and_with_fields_of_view() {
    let folder = capture(|page| {
        page["camera_model"] = json!("opencv_fisheye");
        page["k1"] = json!(0.01);
        page.as_object_mut().unwrap().remove("fl_x");
        page["x_fov"] = json!(60.0);
    });
    let scene = transforms(&folder).unwrap();
    let camera = &scene.photos[0].camera;
    assert!(camera.distortion.fisheye && camera.distortion.k1 == 0.01);
    assert!((camera.fl_x - 8.0 / 30f64.to_radians().tan()).abs() < 1e-12);
    assert_eq!(scene.notes, Vec::<String>::new());
}

#[test]
fn a_wide_fisheye_is_masked_beyond_its_rim() {
    let folder = capture(|page| {
        page["is_fisheye"] = json!(true);
        page["fl_x"] = json!(6.0);
    });
    let scene = transforms(&folder).unwrap();
    let mask = scene.photos[0].mask.as_ref().unwrap();
    assert!(!mask[0], "its corner is 95 degrees off");
    assert!(mask[6 * 16 + 8], "its middle is not");
    holds(&scene.notes.join("\n"), &["9 of 9 photos are masked"]);
}

#[test]
fn a_box_that_no_camera_sees_is_refused_with_what_to_set() {
    let folder = capture(|page| {
        for_frames(page, |_, frame| {
            // Far below the box, and looking down.
            let height = &mut frame["transform_matrix"][1][3];
            *height = json!(height.as_f64().unwrap() - 40.0);
        });
    });
    holds(
        &refusal(&folder),
        &[
            "the scene box",
            "is seen by no camera",
            "-40.00",
            "`bounds`",
        ],
    );
}

#[test]
fn cameras_at_one_place_are_refused() {
    let folder = capture(|page| {
        for_frames(page, |_, frame| {
            (0..3).for_each(|row| frame["transform_matrix"][row][3] = json!(0.25));
        });
    });
    holds(&refusal(&folder), &["all 9 cameras: stand at one place"]);
}

#[test]
fn a_principal_point_outside_the_photo_is_noted_and_one_far_outside_refused() {
    let folder = capture(|page| page["cx"] = json!(20.0));
    holds(
        &read(&folder).1,
        &["the principal point (20, 6)", "outside its 16x12 pixels"],
    );
    let folder = capture(|page| page["cx"] = json!(400.0));
    holds(&refusal(&folder), &["(400, 6) lies far outside"]);
}

#[test]
fn georeferenced_cameras_keep_their_digits_and_the_way_back() {
    let offset = [448_262.0, 5_411_932.0, 480.0];
    let folder = capture(|page| {
        page.as_object_mut().unwrap().remove("aabb_scale");
        for_frames(page, |_, frame| {
            for (row, offset) in offset.iter().enumerate() {
                let value = frame["transform_matrix"][row][3].as_f64().unwrap();
                frame["transform_matrix"][row][3] = json!(value + offset);
            }
        });
    });
    let scene = transforms(&folder).unwrap();
    holds(
        &scene.notes.join("\n"),
        &["far from the origin", "goes back"],
    );
    for (photo, known) in scene.photos.iter().zip(ring(9)) {
        let position = photo.camera.position();
        assert!(position.length() < 3.0, "{position}");
        let back = scene.to_source.transform_point3(position);
        assert!(
            back.distance(known.position() + DVec3::from(offset)) < 1e-6,
            "{back}"
        );
    }
}

#[test]
fn masks_beside_photos_and_in_mask_path_leave_pixels_out() {
    // The left half is white.
    let half = |white: bool| {
        image::GrayImage::from_fn(SIZE.0, SIZE.1, |x, _| {
            Luma([255 * u8::from((x < 8) == white)])
        })
    };
    let masked = |folder: &TempDir| {
        let scene = transforms(folder).unwrap();
        assert_eq!(scene.photos.len(), 9, "masks are no photos");
        holds(
            &scene.notes.join("\n"),
            &["9 of 9 photos are masked (50.0 %"],
        );
        let mask = scene.photos[4].mask.clone().unwrap();
        (mask[0], mask[15])
    };
    let dynamic = capture(|_| {});
    for i in 0..9 {
        let path = dynamic
            .path()
            .join(format!("images/dynamic_mask_{i:04}.png"));
        save(half(true), &path, ImageFormat::Png);
    }
    assert_eq!(masked(&dynamic), (false, true), "instant-ngp: white is out");
    let named = capture(|page| for_frames(page, |_, frame| frame["mask_path"] = json!("m.png")));
    save(half(true), &named.path().join("m.png"), ImageFormat::Png);
    assert_eq!(masked(&named), (true, false), "nerfstudio: black is out");
    let of_colmap = capture(|_| {});
    for i in 0..9 {
        let path = of_colmap.path().join(format!("masks/{i:04}.png.png"));
        save(half(false), &path, ImageFormat::Png);
    }
    assert_eq!(masked(&of_colmap), (false, true), "COLMAP: black is out");
}

/// A JPEG with an EXIF orientation.
fn with_orientation(image: &RgbImage, orientation: u8) -> Vec<u8> {
    let mut jpeg = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 100);
    encoder.encode_image(image).unwrap();
    let tiff = [
        &b"Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0"[..],
        &[orientation, 0, 0, 0, 0, 0, 0],
    ]
    .concat();
    let length = (tiff.len() as u16 + 2).to_be_bytes();
    let segment = [&[0xFF, 0xE1][..], &length, &tiff].concat();
    [&jpeg[..2], &segment, &jpeg[2..]].concat()
}

#[test]
fn exif_orientation_turns_photos_where_their_cameras_are_for_that() {
    let turned = |w: u32, h: u32| {
        let folder = capture(|page| {
            page["w"] = json!(w);
            page["h"] = json!(h);
        });
        for i in 0..9 {
            let path = folder.path().join(format!("images/{i:04}.png"));
            std::fs::write(path, with_orientation(&photo(i), 6)).unwrap();
        }
        let scene = transforms(&folder).unwrap();
        let first = &scene.photos[0];
        (first.camera.width, first.rgb[0], scene.notes.join("\n"))
    };
    let (width, red, notes) = turned(12, 16);
    holds(
        &notes,
        &["9 photos have the EXIF orientation 6 and are turned"],
    );
    // Red grows to the right; turned clockwise it grows downwards, from the same corner's row.
    assert_eq!(width, 12);
    assert!(red < 0.2, "{red}");
    let (width, _, notes) = turned(16, 12);
    assert_eq!(width, 16);
    holds(&notes, &["EXIF orientation 6, which is not applied"]);
}

#[test]
fn a_jpeg_that_was_cut_short_is_refused_by_name() {
    let folder = capture(|_| {});
    let path = folder.path().join("images/0003.png");
    let noise = |x: u32, y: u32| (x * 37 + y * 91 + x * y * 13) as u8;
    let busy = RgbImage::from_fn(64, 48, |x, y| {
        Rgb([noise(x, y), noise(y, x), noise(x + 7, y)])
    });
    let jpeg = with_orientation(&busy, 1);
    std::fs::write(&path, &jpeg).unwrap();
    assert_eq!(read(&folder).0, 9, "the whole one is read");
    std::fs::write(&path, &jpeg[..jpeg.len() / 2]).unwrap();
    holds(
        &refusal(&folder),
        &[
            "SCENE/images/0003.png: not a readable photo",
            "it was cut short",
            "copy it again",
        ],
    );
}

#[test]
fn exr_tiff_webp_and_deep_pngs_are_read() {
    let linear = Rgb32FImage::from_fn(SIZE.0, SIZE.1, |x, _| {
        Rgb([0.214_041_14, x as f32 / 8.0, 0.0])
    });
    let deep = image::ImageBuffer::from_fn(SIZE.0, SIZE.1, |_, _| Rgb([32_900u16, 257, 65_535]));
    let with = |name: &str, save: &dyn Fn(&Path)| {
        let folder = capture(|_| {});
        std::fs::remove_file(folder.path().join("images/0004.png")).unwrap();
        save(&folder.path().join(format!("images/{name}")));
        let scene = transforms(&folder).unwrap();
        assert_eq!(scene.photos.len(), 9, "{name}");
        (scene.photos[4].rgb[..3].to_vec(), scene.notes.join("\n"))
    };
    let near = |values: &[f32], wanted: [f32; 3]| {
        values
            .iter()
            .zip(wanted)
            .for_each(|(a, b)| assert!((a - b).abs() < 1e-4, "{values:?}"));
    };
    let (exr, notes) = with("0004.exr", &|path| {
        save(linear.clone(), path, ImageFormat::OpenExr)
    });
    near(&exr, [0.5, 0.0, 0.0]);
    holds(&notes, &["1 photos hold linear values above 1"]);
    let deep_values = [32_900.0 / 65_535.0, 257.0 / 65_535.0, 1.0];
    for (name, format) in [
        ("0004.tif", ImageFormat::Tiff),
        ("0004.png", ImageFormat::Png),
    ] {
        let (values, _) = with(name, &|path| save(deep.clone(), path, format));
        near(&values, deep_values);
        assert_ne!(values[0], 128.0 / 255.0, "all sixteen bits count");
    }
    let (webp, _) = with("0004.webp", &|path| save(photo(4), path, ImageFormat::WebP));
    near(&webp, [0.0, 0.0, 4.0 / 255.0]);
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

/// A reconstruction in text of so many cameras, with photos under `images`; the text of the images
/// may be changed.
fn reconstruction(cameras: &[Camera], lens: &str, line_of_points: bool) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut images = String::from("# images\n");
    let mut points = String::new();
    for (i, camera) in cameras.iter().enumerate() {
        let mut pose = camera.camera_to_world;
        (pose.y_axis, pose.z_axis) = (-pose.y_axis, -pose.z_axis);
        let (_, turn, t) = pose.inverse().to_scale_rotation_translation();
        let turn: DQuat = turn;
        let w = turn.w;
        let x = turn.x;
        let y = turn.y;
        let z = turn.z;
        writeln!(
            images,
            "{} {w} {x} {y} {z} {} {} {} 1 {i:04}.png",
            i + 1,
            t.x,
            t.y,
            t.z
        )
        .unwrap();
        if line_of_points {
            images.push('\n');
        }
        save(
            photo(i),
            &folder.path().join(format!("images/{i:04}.png")),
            ImageFormat::Png,
        );
    }
    for i in 0..40 {
        let at = |k: u32| f64::from((i * k) % 11) / 11.0 - 0.5;
        write!(points, "{i} {} {} {} 9 9 9 0.5", at(3), at(5), at(7)).unwrap();
        (1..=cameras.len()).for_each(|image| write!(points, " {image} 0").unwrap());
        points.push('\n');
    }
    let place = folder.path().join("sparse/0");
    std::fs::create_dir_all(&place).unwrap();
    std::fs::write(place.join("cameras.txt"), format!("1 {lens}\n")).unwrap();
    std::fs::write(place.join("images.txt"), images).unwrap();
    std::fs::write(place.join("points3D.txt"), points).unwrap();
    folder
}

const PINHOLE: &str = "PINHOLE 16 12 15 15 8 6";

fn scene_of(folder: &TempDir, size: Option<(u32, u32)>) -> (SceneData, String) {
    let scene = colmap(folder.path(), None, size).read().unwrap();
    let notes = scene.notes.join("\n");
    (scene, notes)
}

#[test]
fn photos_in_folders_within_the_folder_are_read() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    let images = folder.path().join("sparse/0/images.txt");
    let mut text = std::fs::read_to_string(&images).unwrap();
    for i in 0..9 {
        let name = format!("{i:04}.png");
        let within = format!("cam{}/{name}", i % 2);
        std::fs::create_dir_all(folder.path().join(format!("images/cam{}", i % 2))).unwrap();
        let old = folder.path().join("images").join(&name);
        std::fs::rename(old, folder.path().join("images").join(&within)).unwrap();
        text = text.replace(&name, &within);
    }
    std::fs::write(images, text).unwrap();
    let (scene, notes) = scene_of(&folder, None);
    assert_eq!((scene.photos.len(), notes.as_str()), (9, ""));
}

#[test]
fn photos_that_are_not_registered_are_counted() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    (9..30).for_each(|i| {
        save(
            photo(i),
            &folder.path().join(format!("images/{i:04}.png")),
            ImageFormat::Png,
        );
    });
    let (scene, notes) = scene_of(&folder, None);
    assert_eq!(scene.photos.len(), 9);
    holds(&notes, &["9 of 30 photos have a pose", "such as"]);
}

#[test]
fn records_of_one_line_are_all_read() {
    let folder = reconstruction(&ring(9), PINHOLE, false);
    let (scene, notes) = scene_of(&folder, None);
    assert_eq!(scene.photos.len(), 9);
    holds(
        &notes,
        &["8 of 9 records of images.txt have no line of points"],
    );
    let images = folder.path().join("sparse/0/images.txt");
    let text = std::fs::read_to_string(&images).unwrap();
    std::fs::write(
        &images,
        text.replacen("0000.png\n", "0000.png\n1.5 2.5\n", 1),
    )
    .unwrap();
    let error = colmap(folder.path(), None, None).read().unwrap_err();
    holds(
        &words(error, folder.path()),
        &["images.txt: line 2", "X Y POINT3D_ID"],
    );
}

#[test]
fn lenses_without_distortion_or_with_all_of_opencvs_are_read() {
    for (lens, k6) in [
        ("FULL_OPENCV 16 12 15 15 8 6 0 0 0 0 0 0 0 0", 0.0),
        ("full_opencv 16 12 15 15 8 6 0.1 0 0 0 0 0.1 0 0.01", 0.01),
        ("FOV 16 12 15 15 8 6 0", 0.0),
    ] {
        let (scene, notes) = scene_of(&reconstruction(&ring(9), lens, true), None);
        assert_eq!((scene.photos.len(), notes.as_str()), (9, ""), "{lens}");
        assert_eq!(scene.photos[0].camera.distortion.k6, k6);
    }
    let fisheye = "OPENCV_FISHEYE 16 12 15 15 8 6 0.01 0 0 0";
    let (scene, _) = scene_of(&reconstruction(&ring(9), fisheye, true), None);
    assert!(scene.photos[0].camera.distortion.fisheye);
    let folder = reconstruction(&ring(9), "FOV 16 12 15 15 8 6 0.9", true);
    let error = colmap(folder.path(), None, None).read().unwrap_err();
    holds(
        &words(error, folder.path()),
        &["cameras.txt: line 1", "omega = 0.9", "image_undistorter"],
    );
}

#[test]
fn the_folder_that_has_all_photos_is_taken() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    for i in 0..3 {
        let small = RgbImage::new(8, 6);
        save(
            small,
            &folder.path().join(format!("images_2/{i:04}.png")),
            ImageFormat::Png,
        );
    }
    let (scene, notes) = scene_of(&folder, Some((8, 6)));
    assert_eq!(scene.photos.len(), 9);
    holds(
        &notes,
        &["images_2 has 3 of 9 photos and is passed over: those of images are taken"],
    );
}

#[test]
fn a_camera_far_from_all_others_is_left_out_by_name() {
    let clean = scene_of(&reconstruction(&ring(24), PINHOLE, true), None).0;
    let mut cameras = ring(24);
    cameras[7].camera_to_world.w_axis *= 100.0;
    cameras[7].camera_to_world.w_axis.w = 1.0;
    let (scene, notes) = scene_of(&reconstruction(&cameras, PINHOLE, true), None);
    assert_eq!(scene.photos.len(), 23);
    holds(
        &notes,
        &[
            "the camera of photo 0007 stands",
            "times as far away",
            "left out",
        ],
    );
    let widest = |scene: &SceneData| {
        (0..3)
            .map(|i| scene.bounds[1][i] - scene.bounds[0][i])
            .fold(0.0, f64::max)
    };
    assert!(widest(&scene) < 1.2 * widest(&clean));
}

#[test]
fn of_several_reconstructions_the_largest_is_read_and_the_others_named() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    std::fs::rename(
        folder.path().join("sparse/0"),
        folder.path().join("sparse/1"),
    )
    .unwrap();
    let small = reconstruction(&ring(3), PINHOLE, true);
    std::fs::rename(
        small.path().join("sparse/0"),
        folder.path().join("sparse/0"),
    )
    .unwrap();
    let (scene, notes) = scene_of(&folder, None);
    assert_eq!(scene.photos.len(), 9);
    holds(
        &notes,
        &["there are 2 reconstructions (0 with 3 photos, 1 with 9 photos): 1 is read"],
    );
}

#[test]
fn points_without_tracks_are_not_called_missing() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    let points = folder.path().join("sparse/0/points3D.txt");
    let text = std::fs::read_to_string(&points).unwrap();
    let without = |line: &str| line.split(' ').take(8).collect::<Vec<_>>().join(" ") + "\n";
    std::fs::write(&points, text.lines().map(without).collect::<String>()).unwrap();
    let (scene, notes) = scene_of(&folder, None);
    holds(
        &notes,
        &["they have no tracks", "all points in each photo's view"],
    );
    let camera = &scene.photos[0].camera;
    assert!(
        camera.far / camera.near < 2.0,
        "{} {}",
        camera.near,
        camera.far
    );
}

#[test]
fn a_number_that_occurs_twice_is_refused_by_line() {
    let folder = reconstruction(&ring(9), PINHOLE, true);
    let images = folder.path().join("sparse/0/images.txt");
    let text = std::fs::read_to_string(&images)
        .unwrap()
        .replace("\n3 ", "\n2 ");
    std::fs::write(&images, text).unwrap();
    let error = colmap(folder.path(), None, None).read().unwrap_err();
    holds(
        &words(error, folder.path()),
        &["images.txt: line 6: IMAGE_ID 2 is also that of 0001.png"],
    );
}
