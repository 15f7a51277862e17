//! COLMAP reconstructions: written in both formats from known cameras, read back, broken in every
//! way, and a real one where it is at hand.

mod files;
mod refusals;
mod similarity;

use formats::Camera;
use scene::{Photo, Reader};

use self::files::{binary, text, written};
use self::similarity::{Similarity, assert_similar};
use crate::common::{BENT, SIZE, colmap, known_cameras, llff, real, write_photo};

fn cameras(photos: &[Photo]) -> Vec<Camera> {
    photos.iter().map(|photo| photo.camera).collect()
}

#[test]
fn cameras_that_were_written_come_back_up_to_one_similarity() {
    for (files, extension) in [(text(), "txt"), (binary(), "bin")] {
        let scene = {
            let folder = written(&files, extension);
            colmap(folder.path(), None, None).read().unwrap()
        };
        assert_eq!(
            scene
                .photos
                .iter()
                .map(|photo| photo.name.as_str())
                .collect::<Vec<_>>(),
            ["photo 0", "photo 1", "photo 2"]
        );
        assert_similar(&known_cameras(BENT), &cameras(&scene.photos), 1e-6);
        let camera = &scene.photos[1].camera;
        assert_eq!(
            (camera.fl_x, camera.fl_y, camera.cx, camera.cy),
            (30.0, 31.0, 12.5, 8.5)
        );
        assert_eq!(camera.distortion, BENT);
        // The middle camera's points lie from 10 to 29.5; the nearest of all is at depth 1 now.
        assert!(
            (camera.far / camera.near - 29.5 / 10.0).abs() < 0.02,
            "{} {}",
            camera.near,
            camera.far
        );
        let nearest = scene
            .photos
            .iter()
            .map(|photo| photo.camera.near)
            .fold(f64::INFINITY, f64::min);
        assert!((nearest - 1.0).abs() < 1e-12 && scene.notes.is_empty());
    }
}

#[test]
fn without_points_or_some_photos_the_rest_is_read_and_noted() {
    let folder = written(&binary(), "bin");
    std::fs::remove_file(folder.path().join("sparse/0/points3D.bin")).unwrap();
    std::fs::remove_file(folder.path().join("images/photo 1.png")).unwrap();
    std::fs::write(
        folder.path().join("sparse/0/rigs.bin"),
        "what newer versions add",
    )
    .unwrap();
    let scene = colmap(folder.path(), None, None).read().unwrap();
    assert_eq!(scene.photos.len(), 2);
    let notes = scene.notes.join("\n");
    assert!(
        notes.contains("1 of 3 photos are missing, such as photo 1.png"),
        "{notes}"
    );
    assert!(notes.contains("enough sparse points"), "{notes}");
    assert!(notes.contains("rigs.bin: not read"), "{notes}");
}

#[test]
fn the_digest_follows_the_reconstruction_and_the_photos() {
    let folder = written(&binary(), "bin");
    let digest = || colmap(folder.path(), None, None).digest().unwrap();
    let first = digest();
    std::fs::write(folder.path().join("sparse/0/rigs.bin"), "not needed").unwrap();
    assert_eq!(digest(), first);
    write_photo(&folder.path().join("images/photo 0.png"), SIZE, 7);
    assert_ne!(digest(), first);
}

/// LLFF's poses of fern were found in another reconstruction, of photos four times as large.
#[test]
fn the_real_fern_is_the_same_scene_as_its_llff_poses() {
    let Some(folder) = real("llff/fern") else {
        return;
    };
    let size = Some((126, 94));
    let ours = colmap(&folder, None, size).read().unwrap();
    let theirs = llff(&folder, None, size).read().unwrap();
    assert_eq!(ours.photos.len(), 20);
    let a = cameras(&theirs.photos);
    let b = cameras(&ours.photos);
    let fit = Similarity::between(&a, &b);
    for (i, (a, b)) in a.iter().zip(&b).enumerate() {
        assert_eq!(theirs.photos[i].name, ours.photos[i].name);
        let off = fit.apply(a.position()).distance(b.position());
        let turned = (fit.turn * a.camera_to_world.z_axis.truncate())
            .angle_between(b.camera_to_world.z_axis.truncate());
        println!(
            "{}: {off:.4} off, turned by {:.2} degrees; near {:.3} {:.3}, far {:.2} {:.2}",
            ours.photos[i].name,
            turned.to_degrees(),
            a.near * fit.scale,
            b.near,
            a.far * fit.scale,
            b.far
        );
        assert!(
            off < 0.02 && turned < 0.02,
            "camera {i} is {off} off and turned by {turned}"
        );
        assert!(
            (a.near * fit.scale / b.near - 1.0).abs() < 0.25
                && (a.far * fit.scale / b.far - 1.0).abs() < 0.25
        );
        assert!(
            (a.fl_x / b.fl_x - 1.0).abs() < 0.03,
            "{} {}",
            a.fl_x,
            b.fl_x
        );
    }
}
