//! What leaves for film, games and other tools: frames, cameras, moving pictures, latents. Whether other
//! libraries take them is tried by `tests/exports`.

use std::fs;

use artifacts_schema::{Artifact, ImageSet, Latents, StoredImages};
use exr::prelude::{FlatSamples, ReadChannels, ReadLayers};
use formats::{FileBytes, TensorFile};
use glam::DMat4;

use crate::space::{Said, Space};

/// A drawn scene with a field, and a path through it.
const FLIGHT: &str = r#"(
    name: "flight",
    stages: {
        "scene": Scene(source: Procedural(views: 4, size: (48, 37), samples: 1), downscale: 1, holdout: 4),
        "fit": Fit(images: "scene.train", steps: 60, samples: 8192),
        "fly": Render(field: "fit", cameras: "scene.train", path: Some(Circle(frames: 5))),
        "encode": Encode(images: "scene.train"),
    },
)"#;

const IMAGES: &str = "out/flight/fly/images";

fn flown() -> Space {
    let space = Space::new();
    fs::write(space.path("flight.ron"), FLIGHT).unwrap();
    space.ok(&["run", "flight.ron"]);
    space
}

/// What a command says that the command line makes no sense of.
fn refused(space: &Space, arguments: &[&str]) -> Said {
    let said = space.say(arguments);
    assert_eq!(said.code, 2, "{}", said.err);
    said
}

/// The channels of a file's first part, by name.
fn channels(path: &std::path::Path) -> Vec<(String, FlatSamples)> {
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .unwrap();
    let list = image.layer_data.channel_data.list.into_iter();
    list.map(|channel| (channel.name.to_string(), channel.sample_data))
        .collect()
}

#[test]
fn frames_hold_what_was_rendered_to_the_last_bit() {
    let space = flown();
    let said = space.ok(&[
        "export",
        "exr",
        IMAGES,
        "-o",
        "shot/fly.####.exr",
        "--first=1001",
        "--numbers=float",
        "--fps=23.976",
        "--json",
    ]);
    assert_eq!(said.json()["last"], 1005);
    let images = ImageSet::read(&space.path(IMAGES)).unwrap();
    for (i, view) in images.views.iter().enumerate() {
        let channels = channels(&space.path(&format!("shot/fly.{}.exr", 1001 + i)));
        let names: Vec<&str> = channels.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["A", "B", "G", "N.X", "N.Y", "N.Z", "R", "depth.Z"]);
        let green = view.pixels.rgb.iter().skip(1).step_by(3).copied().collect();
        assert_eq!(channels[2].1, FlatSamples::F32(green));
        assert_eq!(channels[7].1, FlatSamples::F32(view.depth.clone().unwrap()));
        let normals = [3, 4, 5].map(|at| match &channels[at].1 {
            FlatSamples::F32(values) => values.clone(),
            other => panic!("{other:?}"),
        });
        let lengths =
            (0..normals[0].len()).map(|p| normals.iter().map(|n| n[p] * n[p]).sum::<f32>());
        let solid = lengths
            .clone()
            .filter(|length| (length - 1.0).abs() < 1e-5)
            .count();
        let none = lengths.filter(|length| *length == 0.0).count();
        assert_eq!(solid + none, 48 * 37);
        assert!(solid > 400, "{solid}");
    }
    let meta = exr::meta::MetaData::read_from_file(space.path("shot/fly.1001.exr"), true).unwrap();
    let header = &meta.headers[0];
    assert_eq!(header.own_attributes.frames_per_second, Some((24000, 1001)));
    assert_eq!(
        header.own_attributes.comments.as_ref().unwrap().to_string(),
        "frame_0000"
    );
    let color = header
        .own_attributes
        .other
        .get(b"colorInteropID".as_slice());
    assert_eq!(color.unwrap().to_text().unwrap(), "lin_rec709_scene");
}

#[test]
fn the_same_frames_are_the_same_files_and_a_scene_reads_them() {
    let space = flown();
    for folder in ["a", "b"] {
        let pattern = format!("{folder}/x.#.exr");
        space.ok(&[
            "export",
            "exr",
            IMAGES,
            "-o",
            &pattern,
            "--parts",
            "--compression=piz",
        ]);
    }
    for i in 1..=5 {
        let [a, b] =
            ["a", "b"].map(|folder| fs::read(space.path(&format!("{folder}/x.{i}.exr"))).unwrap());
        assert_eq!(a, b);
    }
}

#[test]
fn what_frames_cannot_be_is_refused_before_anything_is_written() {
    let space = flown();
    for (pattern, told) in [
        ("fly.####.exr", "has no folder of its own"),
        ("shot/fly.exr", "has no place for a number"),
        ("shot/#.#.exr", "has two places for a number"),
        ("shot/fly.####.png", "does not end in .exr"),
    ] {
        let said = refused(&space, &["export", "exr", IMAGES, "-o", pattern]);
        assert!(said.err.contains(told), "{}", said.err);
    }
    refused(
        &space,
        &[
            "export",
            "exr",
            "out/flight/fit/field",
            "-o",
            "shot/fly.####.exr",
        ],
    );
    assert!(!space.path("shot").exists());
    let said = space.ok(&[
        "export",
        "exr",
        "out/flight/scene/train",
        "-o",
        "photos/p.##.exr",
    ]);
    assert!(said.err.contains("have no depth"), "{}", said.err);
}

#[test]
fn a_path_is_one_camera_and_photos_are_many() {
    let space = flown();
    let images = StoredImages::open(&space.path(IMAGES)).unwrap();
    let truth = images.cameras();
    let said = space.ok(&["export", "cameras", IMAGES, "-o", "fly.usda"]);
    assert!(
        said.out.contains("a camera of 5 frames, 24 a second"),
        "{}",
        said.out
    );
    let text = fs::read_to_string(space.path("fly.usda")).unwrap();
    let samples: Vec<DMat4> = text
        .lines()
        .filter(|line| line.contains(": ( ("))
        .map(|line| {
            let numbers = line.split_once(": ").unwrap().1.split(['(', ')', ',', ' ']);
            let numbers = numbers
                .filter(|word| !word.is_empty())
                .map(|word| word.parse().unwrap());
            DMat4::from_cols_slice(&numbers.collect::<Vec<f64>>())
        })
        .collect();
    let poses: Vec<DMat4> = truth
        .iter()
        .map(|(_, camera)| camera.camera_to_world)
        .collect();
    assert_eq!(samples, poses, "to the last bit");

    let said = space.ok(&[
        "export",
        "cameras",
        "out/flight/scene/train",
        "-o",
        "photos.gltf",
        "--json",
    ]);
    assert_eq!(said.json()["cameras"], 3);
    let page: serde_json::Value =
        serde_json::from_slice(&fs::read(space.path("photos.gltf")).unwrap()).unwrap();
    assert_eq!(page["cameras"].as_array().unwrap().len(), 3);
    assert!(page.get("animations").is_none());
    let said = space.ok(&[
        "export",
        "cameras",
        "out/flight/scene/train",
        "--as=path",
        "-o",
        "photos.glb",
    ]);
    assert!(said.out.contains("a camera of 3 frames"), "{}", said.out);
    let said = refused(&space, &["export", "cameras", IMAGES, "-o", "fly.fbx"]);
    assert!(said.err.contains(".usda, .gltf or .glb"), "{}", said.err);
}

#[test]
fn a_moving_picture_needs_no_other_program_as_webp_and_says_what_it_needs_else() {
    let space = flown();
    space.ok(&["export", "video", IMAGES, "-o", "fly.webp", "--fps=12"]);
    let bytes = fs::read(space.path("fly.webp")).unwrap();
    assert_eq!(
        (&bytes[..4], &bytes[8..16]),
        (&b"RIFF"[..], &b"WEBPVP8X"[..])
    );
    assert_eq!(bytes.windows(4).filter(|part| part == b"ANMF").count(), 5);

    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = |file: &str| fs::metadata(space.path(file)).unwrap().permissions().mode();
        assert_eq!(
            mode("fly.webp"),
            mode("flight.ron"),
            "as any other file that the user writes"
        );
    }

    let without = |file: &str| {
        let mut command = space.command(&["export", "video", IMAGES, "-o", file]);
        Said::new(command.env("PATH", space.path("empty")).output().unwrap())
    };
    let said = without("fly.mp4");
    assert_eq!(said.code, 2);
    assert!(
        said.err.contains("there is no `ffmpeg` on the PATH"),
        "{}",
        said.err
    );
    assert!(said.err.contains("apt install ffmpeg"), "{}", said.err);
    assert!(!space.path("fly.mp4").exists());
    let said = refused(
        &space,
        &[
            "export",
            "video",
            "out/flight/scene/train",
            "-o",
            "a.webp",
            "--show=depth",
        ],
    );
    assert!(said.err.contains("no image has any depth"), "{}", said.err);
}

#[cfg(unix)]
#[test]
fn what_ffmpeg_says_is_told_and_nothing_is_left() {
    use std::os::unix::fs::PermissionsExt;
    let space = flown();
    // It reads nothing, and complains at length.
    let script = "#!/bin/sh\nexec 0<&-\ni=0\nwhile [ $i -lt 9000 ]; do echo \"line $i\" >&2; i=$((i+1)); done\necho 'Unknown encoder' >&2\nexit 3\n";
    fs::create_dir(space.path("bin")).unwrap();
    fs::write(space.path("bin/ffmpeg"), script).unwrap();
    fs::set_permissions(space.path("bin/ffmpeg"), fs::Permissions::from_mode(0o755)).unwrap();
    let mut command = space.command(&["export", "video", IMAGES, "-o", "fly.webm"]);
    let said = Said::new(command.env("PATH", space.path("bin")).output().unwrap());
    assert_eq!(said.code, 2);
    let told: String = said
        .err
        .split_whitespace()
        .filter(|word| *word != "│")
        .collect::<Vec<_>>()
        .join(" ");
    assert!(
        told.contains("`ffmpeg` gave up (exit status: 3)") && told.contains("Unknown encoder"),
        "{}",
        said.err
    );
    assert!(!space.path("fly.webm").exists());
}

#[test]
fn latents_are_what_the_vae_gave() {
    let space = flown();
    let folder = "out/flight/encode/latents";
    let said = refused(&space, &["export", "latents", folder, "-o", "comfy"]);
    assert!(said.err.contains("--comfyui"), "{}", said.err);
    space.ok(&["export", "latents", folder, "--comfyui", "-o", "comfy"]);
    let truth = Latents::read(&space.path(folder)).unwrap();
    assert_eq!(truth.views.len(), 3);
    for view in &truth.views {
        let bytes = fs::read(space.path(&format!("comfy/{}.latent", view.name))).unwrap();
        let file = TensorFile::new(FileBytes::in_memory(view.name.clone(), bytes)).unwrap();
        let latent = file.tensor("latent_tensor").unwrap();
        assert_eq!(latent.shape, [&[1], &view.tensor.shape[..]].concat());
        assert_eq!(file.tensor("latent_format_version_0").unwrap().shape, [0]);
        for (ours, theirs) in view.tensor.values.iter().zip(&latent.values) {
            let back = f64::from(*theirs) * truth.scaling_factor;
            assert!(
                (back - f64::from(*ours)).abs() <= 1e-7 * f64::from(ours.abs()),
                "{ours} {back}"
            );
        }
    }
}
