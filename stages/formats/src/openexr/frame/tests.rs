use exr::prelude::{ReadChannels, ReadLayers};
use glam::DMat4;

use super::*;

const SIZE: (u32, u32) = (37, 21);

struct Shown {
    camera: Camera,
    pixels: Pixels<Linear>,
    depth: Vec<f32>,
    normals: Vec<[f32; 3]>,
}

fn shown() -> Shown {
    let count = (SIZE.0 * SIZE.1) as usize;
    let ramp = |at: usize| at as f32 / count as f32;
    Shown {
        camera: Camera::centered(SIZE, 40.0, DMat4::IDENTITY, [1.0, 9.0]),
        pixels: Pixels::new(
            (0..3 * count).map(|i| 2.0 * ramp(i / 3)).collect(),
            Some((0..count).map(ramp).collect()),
        ),
        depth: (0..count).map(|i| 1.0 + 1e-6 * i as f32).collect(),
        normals: (0..count).map(|i| [ramp(i), 0.0, -1.0]).collect(),
    }
}

impl Shown {
    fn bytes(&self, options: &FrameOptions) -> Vec<u8> {
        let frame = Frame {
            camera: &self.camera,
            pixels: &self.pixels,
            depth: Some(&self.depth),
            normals: Some(&self.normals),
            mask: None,
            name: "frame_0000",
            about: "{}",
        };
        frame.to_bytes(options).unwrap()
    }
}

/// Names of parts, and all channels by their names.
fn read(bytes: &[u8]) -> (Vec<String>, Vec<(String, FlatSamples)>) {
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .unwrap();
    let mut parts = Vec::new();
    let mut channels = Vec::new();
    for layer in image.layer_data {
        parts.push(
            layer
                .attributes
                .layer_name
                .map_or(String::new(), |name| name.to_string()),
        );
        let list = layer.channel_data.list.into_iter();
        channels.extend(list.map(|channel| (channel.name.to_string(), channel.sample_data)));
    }
    (parts, channels)
}

const OPTIONS: FrameOptions = FrameOptions {
    parts: false,
    half: false,
    packing: Packing::Zip,
    rate: None,
};

#[test]
fn floats_come_back_as_they_were_from_layers_and_from_parts() {
    let shown = shown();
    let (parts, channels) = read(&shown.bytes(&OPTIONS));
    let names: Vec<&str> = channels.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(parts, [""]);
    assert_eq!(names, ["A", "B", "G", "N.X", "N.Y", "N.Z", "R", "depth.Z"]);
    assert_eq!(channels[7].1, FlatSamples::F32(shown.depth.clone()));
    assert_eq!(
        channels[0].1,
        FlatSamples::F32(shown.pixels.alpha.clone().unwrap())
    );
    let (parts, channels) = read(&shown.bytes(&FrameOptions {
        parts: true,
        ..OPTIONS
    }));
    let names: Vec<&str> = channels.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(parts, ["rgba", "depth", "N"]);
    assert_eq!(names, ["A", "B", "G", "R", "Z", "X", "Y", "Z"]);
    assert_eq!(channels[4].1, FlatSamples::F32(shown.depth.clone()));
    assert_eq!(
        channels[7].1,
        FlatSamples::F32(vec![-1.0; shown.depth.len()])
    );
}

#[test]
fn halves_are_the_nearest_and_depths_stay_floats() {
    let shown = shown();
    for packing in [
        Packing::None,
        Packing::Rle,
        Packing::Zips,
        Packing::Zip,
        Packing::Piz,
    ] {
        let bytes = shown.bytes(&FrameOptions {
            half: true,
            packing,
            ..OPTIONS
        });
        let (_, channels) = read(&bytes);
        let red = (0..shown.depth.len()).map(|i| f16::from_f32(shown.pixels.rgb[3 * i]));
        assert_eq!(
            channels[6].1,
            FlatSamples::F16(red.collect()),
            "{packing:?}"
        );
        assert_eq!(
            channels[7].1,
            FlatSamples::F32(shown.depth.clone()),
            "{packing:?}"
        );
        assert_eq!(
            bytes,
            shown.bytes(&FrameOptions {
                half: true,
                packing,
                ..OPTIONS
            })
        );
    }
}

#[test]
fn cosine_transforms_lose_little() {
    let shown = shown();
    for packing in [Packing::Dwaa, Packing::Dwab] {
        let (_, channels) = read(&shown.bytes(&FrameOptions {
            half: true,
            packing,
            ..OPTIONS
        }));
        let (FlatSamples::F16(red), FlatSamples::F32(depth)) = (&channels[6].1, &channels[7].1)
        else {
            panic!("{:?}", channels[6].1)
        };
        let worst = red.iter().zip(shown.pixels.rgb.chunks(3));
        let worst = worst
            .map(|(a, b)| (a.to_f32() - b[0]).abs())
            .fold(0.0, f32::max);
        assert!(worst < 0.01, "{packing:?}: {worst}");
        assert_eq!(*depth, shown.depth, "{packing:?}");
    }
}

#[test]
fn what_is_too_bright_for_halves_stays_bright() {
    assert_eq!(to_half(1e6), f16::MAX);
    assert_eq!(to_half(f32::INFINITY), f16::INFINITY);
    assert!(to_half(f32::NAN).is_nan());
}
